# SPDX-License-Identifier: GPL-3.0-or-later
"""For scripts and other add-ons: everything that the buttons do, as functions that need neither window nor selection.

In an installed extension this module is `bl_ext.user_default.zoomout_transfer.api`. With two mesh objects of the scene:

>>> match = api.match_objects(context, hero, scan)
>>> bool(match.confidence.mean() > 0.5)
True
>>> report = api.transfer_objects(context, hero, scan, data=["uv_maps", "vertex_groups"])
>>> report["written"]["uv_maps"], report["written"]["vertex_groups"]
(['UVMap'], ['Bone'])

Where the shapes alone lead astray, landmarks settle it: vertices of the one and of the other that correspond.

>>> api.set_landmark(context, hero, number=1, vertex=12)
>>> api.set_landmark(context, scan, number=1, vertex=40)
>>> match = api.match_objects(context, hero, scan, initial="landmarks")
>>> api.landmark_pairs(context, hero, scan).numbers
(1,)

A target that stands in a pose is taken to the rest pose of the source's armature, and bound to it, so that the bones
pose it at once, by `bind_to_rig(context, hero, scan)`, which transfers the weights, or by `transfer_objects` with
`binding=Binding()`.

The target's topology gets the source's shape, as a shape key, as the mesh itself or as a new object, by `wrap`:

>>> report = api.wrap(context, hero, scan, api.Wrapping(smoothness=0.7))
>>> report["key"] == hero.name
True

What the source wears is copied onto the target, fitted to its body and bound to the same rig, by `dress`:

>>> report = api.dress(context, hero, scan, [hat], api.Dressing(manner="rigid"))
>>> report["objects"]
{'Hat': 'Hat on Scan'}

A character of several objects, each collection's body, eyes and clothes, is matched as a whole by `match_collections`.

A mesh's own symmetry is found in any pose, stored on the mesh, and used by the functions that follow:

>>> symmetry, *others = api.detect_symmetry(context, body, left="X")
>>> symmetry.reverses_orientation, symmetry.has_sides
(True, True)
>>> api.symmetrise_weights(context, body, direction="left_to_right")
"Made 2 vertex groups of 'Body' symmetric"
>>> sides = api.symmetry_of(body).sides()  # of each vertex: 1 on the left, -1 on the right, 0 on the line
>>> int(sides.min()), int(sides.max())
(-1, 1)

Likewise `mirror_shape_key`, `mirror_attributes`, `mirror_sculpt`, `name_sides`, `select_symmetry_line` and
`check_symmetry`, which shows by colours what differs.

Functions report their progress to listeners, which can end them by an exception: nothing is written before the end.

>>> import zoomout_core as zo
>>> stages = []
>>> with zo.progress(lambda progress: stages.append(progress.stage)):
...     match = api.match_objects(context, hero, scan, k_final=40)
>>> stages[0]
'Reading the meshes'

A mesh that cannot be used raises a `zoomout_core.MeshError`, whose message is a sentence for the user.
"""

from __future__ import annotations

from bpy.types import Context, Object

import zoomout_core as zo

from .adapters import DATA, USUAL_DATA, Binding, Settings
from .mesh_data import surface_point_of_vertex
from .scene import landmarks
from .scene.landmarks import LandmarkPairs, landmark_pairs
from .services.collection_match import match_collections
from .services.dress import Dressing, dress
from .services.match import match_objects
from .services.symmetry.check import check_symmetry
from .services.symmetry.detect import choose_symmetry, detect_symmetry, swap_sides
from .services.symmetry.layers import mirror_attributes
from .services.symmetry.sculpt import mirror_sculpt
from .services.symmetry.shape_keys import mirror_shape_key
from .services.symmetry.sides import name_sides, select_symmetry_line
from .services.symmetry.weights import symmetrise_weights
from .services.transfer import bind_to_rig, transfer_objects
from .services.wrap import Wrapping, wrap
from .storage.stored_report import transfer_report
from .storage.stored_symmetry import read as symmetry_of

__all__ = [
    "DATA",
    "USUAL_DATA",
    "Binding",
    "Dressing",
    "LandmarkPairs",
    "Settings",
    "Wrapping",
    "bind_to_rig",
    "check_symmetry",
    "choose_symmetry",
    "detect_symmetry",
    "dress",
    "landmark_pairs",
    "match_collections",
    "match_objects",
    "mirror_attributes",
    "mirror_sculpt",
    "mirror_shape_key",
    "name_sides",
    "select_symmetry_line",
    "set_landmark",
    "swap_sides",
    "symmetrise_weights",
    "symmetry_of",
    "transfer_objects",
    "transfer_report",
    "wrap",
]


def set_landmark(context: Context, obj: Object, number: int, vertex: int, name: str = "") -> None:
    """Give a landmark a place on an object, in place of the one that it may have there.

    Args:
        context: Blender's; the object is in its scene.
        obj: a mesh object.
        number: of the landmark; it corresponds to the same number on other objects.
        vertex: of the object's own mesh.
        name: what it marks.

    Raises:
        MeshError: there is no such vertex, or the modifiers leave no surface there.
    """
    if obj.type != "MESH" or not 0 <= vertex < len(obj.data.vertices):
        raise zo.MeshError(f"'{obj.name}' is not a mesh with a vertex {vertex}: choose another one.")
    place = surface_point_of_vertex(obj, vertex, context.evaluated_depsgraph_get())
    landmarks.set_landmark(context.scene, obj, place, number, name)
