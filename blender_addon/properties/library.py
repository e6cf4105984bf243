# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of the search for a source in libraries, and its results.

Blender needs evaluated property annotations, so this module does not postpone them.
"""

from bpy.props import BoolProperty, CollectionProperty, StringProperty
from bpy.types import PropertyGroup


class ZOOMOUT_PG_found_source(PropertyGroup):
    """A file that was found; its `name` is its path."""

    line: StringProperty(name="Result", description="Name of the file, and how well it fits")
    fits: BoolProperty(name="Fits", description="Whether the file fits the target well enough to be its source")


class LibrarySettings:
    """Where finished characters are searched."""

    library_folder: StringProperty(
        name="Library",
        description="Folder of finished characters; its subfolders are included",
        subtype="DIR_PATH",
    )
    use_asset_libraries: BoolProperty(
        name="Asset Libraries",
        description="Search the asset libraries of the Preferences as well",
        default=False,
    )


class FoundSettings:
    """The files that were found for a target."""

    found_sources: CollectionProperty(
        name="Found Sources", description="Files that the target was compared with", type=ZOOMOUT_PG_found_source
    )
    found_for: StringProperty(name="Target", description="Name of the object that they were found for")
    found_part: StringProperty(name="Source of a Part", description="File that fits a part of the target better")
    found_part_line: StringProperty(name="Part", description="The part, and how well that file fits it")
    found_part_joints: StringProperty(name="Joints", description="Names of the bones of the part, one a line")


# In the order of registration.
CLASSES = (ZOOMOUT_PG_found_source,)
