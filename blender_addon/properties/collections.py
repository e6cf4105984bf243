# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of the collections of two characters.

Blender needs evaluated property annotations, so this module does not postpone them.
"""

from bpy.props import PointerProperty
from bpy.types import Collection


class CollectionSettings:
    """Which collections to match."""

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
