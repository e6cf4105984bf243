# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks, stored on the scene: they persist through saving, undo, and renaming of the objects.

Blender needs evaluated property annotations, so this module does not postpone them.
"""

from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatVectorProperty,
    IntProperty,
    IntVectorProperty,
    PointerProperty,
)
from bpy.types import Object, PropertyGroup

from ..mesh_data import SurfacePoint
from .once import ONCE


class ZOOMOUT_PG_place(PropertyGroup):
    """The place of a landmark on one object: a `SurfacePoint`."""

    object: PointerProperty(name="Object", description="Object that the landmark is on", type=Object)
    face: IntProperty(name="Face", description="Face that the landmark is on")
    vertices: IntVectorProperty(name="Vertices", description="Three vertices of the face")
    weights: FloatVectorProperty(
        name="Weights", description="Barycentric coordinates of the landmark between these vertices"
    )
    position: FloatVectorProperty(
        name="Position", description="Position of the landmark when it was placed", subtype="XYZ"
    )
    proposed: BoolProperty(
        name="Proposed",
        description="The match proposed this position, which is not used until it is moved or confirmed",
    )
    counts: IntVectorProperty(
        name="Counts", description="Number of vertices and faces of the mesh at that time", size=2
    )

    def take(self, place: SurfacePoint) -> None:
        """Store a surface point."""
        for name in SurfacePoint.__annotations__:
            setattr(self, name, getattr(place, name))

    def place(self) -> SurfacePoint:
        """The stored surface point."""
        return SurfacePoint(
            self.face, tuple(self.vertices), tuple(self.weights), tuple(self.position), tuple(self.counts)
        )


class ZOOMOUT_PG_landmark(PropertyGroup):
    """A numbered landmark, with a place on each object that it was set on. Its `name` describes the place."""

    number: IntProperty(name="Number", description="Number drawn beside the landmark")
    places: CollectionProperty(
        name="Places", description="Position of the landmark on each object", type=ZOOMOUT_PG_place
    )


class LandmarkSettings:
    """The landmarks of a scene."""

    landmarks: CollectionProperty(
        name="Landmarks",
        description="Corresponding points, by number",
        type=ZOOMOUT_PG_landmark,
    )
    active_landmark: IntProperty(
        name="Active Landmark",
        description="Active landmark of the list",
    )
    show_landmarks: BoolProperty(
        name="Show",
        description="Draw landmarks in the 3D view, as numbered dots on the source and on the active mesh",
        default=True,
    )


class ImportOptions:
    """Where landmarks are imported from."""

    what: EnumProperty(
        name="Import From",
        description="Objects or groups that mark the points",
        items=(
            ("GROUPS", "Vertex Groups", "At the center of small vertex groups that both objects have"),
            ("EMPTIES", "Empties", "At empties that are children of the objects or near them"),
        ),
        default="GROUPS",
        options=ONCE,
    )


# In the order of registration.
CLASSES = (ZOOMOUT_PG_place, ZOOMOUT_PG_landmark)
