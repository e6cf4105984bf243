# SPDX-License-Identifier: GPL-3.0-or-later
"""The collections of two characters that consist of several objects.

Blender needs evaluated property annotations, so this module does not postpone them.
"""

from bpy.props import PointerProperty
from bpy.types import Collection


class CollectionSettings:
    """Which collections are matched."""

    source_collection: PointerProperty(
        name="Source",
        description="Collection of the meshes to copy data from",
        type=Collection,
    )
    target_collection: PointerProperty(
        name="Target",
        description="Collection of the meshes that receive the data",
        type=Collection,
    )
