# SPDX-License-Identifier: GPL-3.0-or-later
"""The guide, which the sidebar and *Online Manual* in the context menu open.

The guide and the news of updates are shipped with the extension, so that they work offline and fit the installed
version.
"""

from __future__ import annotations

from pathlib import Path

import bpy

from ..properties.transfer import BindChoice, BindOptions, BindView, BlendOptions, TransferOptions

# An installed zip has HTML pages in the package; a checkout has their Markdown beside it.
PACKAGE = Path(__file__).parents[1]
SHIPPED, WRITTEN = PACKAGE / "docs", PACKAGE.parent / "docs"
GUIDE, RULES, NEWS = "blender", "transfer", "whats_new"
# Patterns of operators and properties in lower case, as Blender looks them up; the first match counts.
PLACES = (
    ("bpy.ops.zoomout.transfer*", RULES),
    ("bpy.ops.zoomout.cut_seams*", RULES),
    ("bpy.ops.zoomout.bind_to_rig*", RULES),
    ("bpy.ops.zoomout.move_rig*", GUIDE),
    ("bpy.ops.zoomout.wrap*", GUIDE),
    *(
        (f"bpy.types.zoomout_pg_settings.{name}", RULES)
        for group in (TransferOptions, BlendOptions, BindChoice, BindOptions, BindView)
        for name in group.__annotations__
    ),
    ("bpy.ops.zoomout.*", GUIDE),
    ("bpy.types.zoomout_*", GUIDE),
)


def address(page: str) -> str:
    """The address of one of the pages, `GUIDE`, `RULES` or `NEWS`, for a browser."""
    return (SHIPPED / f"{page}.html" if SHIPPED.is_dir() else WRITTEN / f"{page}.md").as_uri()


def manual_map() -> tuple[str, tuple[tuple[str, str], ...]]:
    """The manual map for Blender: the prefix of all addresses, and the rest of each by its pattern."""
    return "", tuple((pattern, address(page)) for pattern, page in PLACES)


def register() -> None:
    """Register the guide with Blender."""
    bpy.utils.register_manual_map(manual_map)


def unregister() -> None:
    """Unregister the guide."""
    bpy.utils.unregister_manual_map(manual_map)
