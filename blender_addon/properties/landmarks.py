"""Landmarks, stored on the scene: they persist through saving, undo, and renaming of the objects.

Property annotations are read by Blender as they are, so this module does without postponed evaluation.
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
    """Where a landmark lies on one object: a `SurfacePoint`."""

    object: PointerProperty(name="Object", description="The object that it lies on", type=Object)
    face: IntProperty(name="Face", description="The face that it lies in")
    vertices: IntVectorProperty(name="Vertices", description="Three vertices of the face")
    weights: FloatVectorProperty(name="Weights", description="Its barycentric coordinates between them")
    position: FloatVectorProperty(name="Position", description="Where it was when it was set", subtype="XYZ")
    proposed: BoolProperty(
        name="Proposed",
        description="It was set where a match leads, and does not count before it is moved or confirmed",
    )
    counts: IntVectorProperty(name="Counts", description="Vertices and faces that the mesh had then", size=2)

    def take(self, place: SurfacePoint) -> None:
        """Take the values of a surface point."""
        for name in SurfacePoint.__annotations__:
            setattr(self, name, getattr(place, name))

    def place(self) -> SurfacePoint:
        """The stored surface point."""
        return SurfacePoint(
            self.face, tuple(self.vertices), tuple(self.weights), tuple(self.position), tuple(self.counts)
        )


class ZOOMOUT_PG_landmark(PropertyGroup):
    """A numbered landmark, with a place on each object that it was set on. Its `name` says what it is."""

    number: IntProperty(name="Number", description="What is drawn beside it")
    places: CollectionProperty(name="Places", description="Where it lies on each object", type=ZOOMOUT_PG_place)


class LandmarkSettings:
    """The landmarks of a scene."""

    landmarks: CollectionProperty(
        name="Landmarks",
        description="Places that correspond, by number",
        type=ZOOMOUT_PG_landmark,
    )
    active_landmark: IntProperty(
        name="Active Landmark",
        description="The landmark that is chosen in the list",
    )
    show_landmarks: BoolProperty(
        name="Show",
        description="Draw landmarks in the 3D view, as numbered dots on the source and on the active mesh",
        default=True,
    )


class ImportOptions:
    """Where landmarks are imported from."""

    what: EnumProperty(
        name="What",
        description="What marks the places",
        items=(
            ("GROUPS", "Vertex Groups", "At the centre of small vertex groups that both objects have"),
            ("EMPTIES", "Empties", "Where empties are that belong to the objects, as their children or by lying near"),
        ),
        default="GROUPS",
        options=ONCE,
    )


# In the order in which Blender is to know them.
CLASSES = (ZOOMOUT_PG_place, ZOOMOUT_PG_landmark)
