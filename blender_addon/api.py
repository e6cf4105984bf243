# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything that the buttons do, as functions for scripts and add-ons that need neither window nor selection.

In an installed extension this module is `bl_ext.user_default.zoomout_transfer.api`. With two mesh objects in the scene:

>>> match = api.match_objects(context, hero, scan)
>>> bool(match.confidence.mean() > 0.5)
True
>>> report = api.transfer_objects(context, hero, scan, data=["uv_maps", "vertex_groups"])
>>> report["written"]["uv_maps"], report["written"]["vertex_groups"]
(['UVMap'], ['Bone'])

`keep_linked` lets UVs, colours, attributes and weights of the target follow later edits of the source, by a modifier;
`update_linked` transfers the rest again:

>>> api.keep_linked(context, scan)["UVMap"] > 0.9
True

`bake_textures(context, scan, api.Baking(size=4096))` bakes the images of the source's materials into the UV map of a
matched target, and gives it materials that show them.

`make_levels(context, hero, api.LevelChoice(ratios=(0.5, 0.2)))` makes levels of detail with all data of a mesh;
`api.LevelChoice(meshes=("Low", "Lower"))` uses meshes that were made by hand.

Where the shapes alone mislead the match, set landmarks, which are vertices of both meshes that correspond:

>>> api.set_landmark(context, hero, number=1, vertex=12)
>>> api.set_landmark(context, scan, number=1, vertex=40)
>>> match = api.match_objects(context, hero, scan, initial="landmarks")
>>> api.landmark_pairs(context, hero, scan).numbers
(1,)

`bind_to_rig(context, hero, scan)` moves a posed target to the rest pose of the source's armature, transfers the
weights and binds the target, so that the bones pose it at once; the source, at the same place, is hidden in the
viewport, unless `hide_source` is False. So does `transfer_objects` with `binding=Binding()`.
`move_rig(context, hero, child)` is for a target of another build: it binds the target to a copy of the armature whose
bones are moved into its body. `add_bones(context, princess, child, "Head")` then adds the bones of another source that
move a part, such as its face. `move_armature(context, metarig, hero, child)` moves an armature without weights, such as
a metarig, and binds nothing. `check_motion(context, child)` compares how both play the action: whether feet slide.

`wrap` gives the target's topology the source's shape, as a shape key, as the mesh itself or as a new object:

>>> report = api.wrap(context, hero, scan, api.Wrapping(smoothness=0.7))
>>> report["key"] == hero.name
True

`dress` copies the source's clothes onto the target, fits them to its body and binds them to the same rig:

>>> report = api.dress(context, hero, scan, [hat], api.Dressing(manner="rigid"))
>>> report["objects"]
{'Hat': 'Hat on Scan'}

`rename_shape_keys(context, hero, "arkit")` gives a face's shape keys the names of another convention.

`match_collections` matches two characters of several objects, such as body, eyes and clothes, as a whole.

`find_source(context, scan, ["characters"])` finds the character of a folder that fits a mesh best, and
`append_source(context, path)` appends it.

`detect_symmetry` finds a mesh's own symmetry in any pose and stores it on the mesh, for the functions that follow:

>>> symmetry, *others = api.detect_symmetry(context, body, left="X")
>>> symmetry.reverses_orientation, symmetry.has_sides
(True, True)
>>> api.symmetrise_weights(context, body, direction="left_to_right")
"Made 2 vertex groups of 'Body' symmetric"
>>> sides = api.symmetry_of(body).sides()  # of each vertex: 1 on the left, -1 on the right, 0 on the line
>>> int(sides.min()), int(sides.max())
(-1, 1)

Likewise `mirror_shape_key`, `mirror_attributes`, `mirror_sculpt`, `name_sides`, `select_symmetry_line` and
`check_symmetry`, which colours the mesh by its asymmetry.

Functions report their progress to listeners, which can cancel them by an exception. Nothing is written before the end.

>>> import zoomout_core as zo
>>> stages = []
>>> with zo.progress(lambda progress: stages.append(progress.stage)):
...     match = api.match_objects(context, hero, scan, k_final=40)
>>> stages[0]
'Reading the meshes'

A mesh that cannot be used raises a `zoomout_core.MeshError`, whose message is a sentence for the user.
"""

from __future__ import annotations

from numbers import Integral

from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.arrays import check_counts

from .adapters import DATA, USUAL_DATA, Binding, Settings
from .mesh_data import surface_point_of_vertex
from .scene import landmarks
from .scene.landmarks import LandmarkPairs, landmark_pairs
from .scene.pair import find_mesh, name_of
from .services.bake import Baking, bake_textures
from .services.binding.loose_armature import move_armature
from .services.binding.part import AddedBones, add_bones
from .services.check_motion import check_motion
from .services.dressing.dress import dress
from .services.dressing.read import Dressing
from .services.key_names import rename_shape_keys
from .services.library import append_source, find_source
from .services.live_link import keep_linked, update_linked
from .services.lods import LevelChoice, make_levels
from .services.matching.collection_match import match_collections
from .services.matching.match import match_objects
from .services.symmetry.check import check_symmetry
from .services.symmetry.detect import choose_symmetry, detect_symmetry, swap_sides
from .services.symmetry.layers import mirror_attributes
from .services.symmetry.sculpt import mirror_sculpt
from .services.symmetry.shape_keys import mirror_shape_key
from .services.symmetry.sides import name_sides, select_symmetry_line
from .services.symmetry.weights import symmetrise_weights
from .services.transfer import bind_to_rig, move_rig, transfer_objects
from .services.wrap import Wrapping, wrap
from .storage.stored_report import transfer_report
from .storage.stored_symmetry import read as symmetry_of

__all__ = [
    "DATA",
    "USUAL_DATA",
    "AddedBones",
    "Baking",
    "Binding",
    "Dressing",
    "LandmarkPairs",
    "LevelChoice",
    "Settings",
    "Wrapping",
    "add_bones",
    "append_source",
    "bake_textures",
    "bind_to_rig",
    "check_motion",
    "check_symmetry",
    "choose_symmetry",
    "detect_symmetry",
    "dress",
    "find_source",
    "keep_linked",
    "landmark_pairs",
    "make_levels",
    "match_collections",
    "match_objects",
    "mirror_attributes",
    "mirror_sculpt",
    "mirror_shape_key",
    "move_armature",
    "move_rig",
    "name_sides",
    "rename_shape_keys",
    "select_symmetry_line",
    "set_landmark",
    "swap_sides",
    "symmetrise_weights",
    "symmetry_of",
    "transfer_objects",
    "transfer_report",
    "update_linked",
    "wrap",
]


# Integers of Blender have 32 bits.
LARGEST_NUMBER = 2**31 - 1


def set_landmark(context: Context, obj: Object, number: int, vertex: int, name: str = "") -> None:
    """Set a landmark at a vertex of an object, or move it there.

    Args:
        context: Blender's; the object is in its scene.
        obj: a mesh object.
        number: the landmark's number; it corresponds to the same number on other objects.
        vertex: a vertex of the object's own mesh.
        name: a name for the landmark.

    Raises:
        MeshError: the scene has no such mesh or it has no such vertex, or the modifiers leave no surface there.
        ValueError: the number is not a whole number of one or more, or the name is not text.
    """
    mesh = find_mesh(context, name_of(obj), edited=True).data
    if not isinstance(vertex, Integral) or not 0 <= vertex < len(mesh.vertices):
        raise zo.MeshError(f"'{obj.name}' has no vertex {vertex}: choose another one.")
    check_counts(number=number)
    if number > LARGEST_NUMBER or not isinstance(name, str):
        raise ValueError(
            f"A landmark has the number {number} and the name {name!r:.60}: give a small number, and text."
        )
    place = surface_point_of_vertex(obj, vertex, context.evaluated_depsgraph_get())
    landmarks.set_landmark(context.scene, obj, place, number, name)
