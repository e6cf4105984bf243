# SPDX-License-Identifier: GPL-3.0-or-later
"""The guide that is opened from the sidebar, and by *Online Manual* in the menu of the right mouse button.

It is shipped with the extension, and so is what an update has brought, so that neither needs a network, and both speak
of the version that is installed.
"""

from __future__ import annotations

from pathlib import Path

import bpy

from ..properties.transfer import BindChoice, BindOptions, BlendOptions, TransferOptions

# What a zip has, as pages, and a checkout beside the package, as it is written.
PACKAGE = Path(__file__).parents[1]
SHIPPED, WRITTEN = PACKAGE / "docs", PACKAGE.parent / "docs"
GUIDE, RULES, NEWS = "blender", "transfer", "whats_new"
# Identifiers of operators and properties in lower case, as Blender looks them up, of whom the first that fits counts.
PLACES = (
    ("bpy.ops.zoomout.transfer*", RULES),
    ("bpy.ops.zoomout.cut_seams*", RULES),
    ("bpy.ops.zoomout.bind_to_rig*", RULES),
    ("bpy.ops.zoomout.wrap*", GUIDE),
    *(
        (f"bpy.types.zoomout_pg_settings.{name}", RULES)
        for group in (TransferOptions, BlendOptions, BindChoice, BindOptions)
        for name in group.__annotations__
    ),
    ("bpy.ops.zoomout.*", GUIDE),
    ("bpy.types.zoomout_*", GUIDE),
)


def address(page: str) -> str:
    """The address of one of the pages, `GUIDE`, `RULES` or `NEWS`, for a browser."""
    return (SHIPPED / f"{page}.html" if SHIPPED.is_dir() else WRITTEN / f"{page}.md").as_uri()


def manual_map() -> tuple[str, tuple[tuple[str, str], ...]]:
    """What Blender asks of a manual: the beginning of all addresses, and the rest by identifiers."""
    return "", tuple((pattern, address(page)) for pattern, page in PLACES)


def register() -> None:
    """Make the guide known to Blender."""
    bpy.utils.register_manual_map(manual_map)


def unregister() -> None:
    """Take it away again."""
    bpy.utils.unregister_manual_map(manual_map)
