# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's preferences.

Blender needs evaluated property annotations, so this module does not postpone them.
"""

from bpy.props import BoolProperty
from bpy.types import Context

# The extension's package, by which Blender identifies its preferences.
EXTENSION = __package__.removesuffix(".properties")


class AheadPreferences:
    """Preferences of the work that the extension does ahead."""

    prepare_ahead: BoolProperty(
        name="Prepare Ahead",
        description=(
            "Analyze the source and the target on one processor core as soon as both are selected, so that a match "
            "shows its first colors sooner"
        ),
        default=True,
    )


def prepares_ahead(context: Context) -> bool:
    """Whether shapes are analysed before a match is started: not if the extension is not enabled, as in scripts."""
    addon = context.preferences.addons.get(EXTENSION)
    return addon is not None and addon.preferences.prepare_ahead
