# SPDX-License-Identifier: GPL-3.0-or-later
"""Rigged characters, and targets in one of their poses, whose positions in other poses are known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import bpy
import numpy as np
from bpy.types import Object
from mathutils import Matrix
from scipy.sparse import csr_array

import zoomout_core as zo
from benchmarks.characters.cases import OF_PACK, is_broken, spread
from benchmarks.characters.game import Body, all_frames, one_skin, read_character, set_frame
from benchmarks.generate.remeshing import isotropic
from benchmarks.transfer.cases import CELL
from blender_addon import mesh_data
from blender_addon.demo.character import build_character
from blender_addon.demo.target import POSE, set_pose
from zoomout_core.arrays import Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.transfer import Attribute, Domain, Kind

GENERATED, GAME = "generated", "game"
# Poses of generated characters for binding, and for testing afterwards; rotations of bones in degrees.
BOUND_IN, TAKEN, TURN = 3, 5, 15
# Ratio of the target's vertices to the source's, and their minimum number.
THINNED, FEWEST = 0.6, 3000

# The transform of each bone of an armature from rest.
Stance = dict[str, Matrix]


@dataclass(frozen=True, eq=False)
class Case:
    """A source, and a target in a pose of it.

    Attributes:
        kind: "generated" or "game".
        name: of the character and the pose.
        mesh: how the target was meshed, "isotropic" or "voxels": vertices of the former are on the posed source,
            those of the latter near it.
        source: the object, at rest.
        armature: deforms it.
        target: the target's surface.
        truth: its vertices' places on the source.
        bound_in: the target's pose.
        taken: the poses to test.
    """

    kind: str
    name: str
    mesh: str
    source: Object
    armature: Object
    target: zo.Surface
    truth: zo.SurfaceMap
    bound_in: Stance
    taken: tuple[Stance, ...]


def make_cases(data: Path, max_count: int | None) -> Iterator[Case]:
    """Generated characters in several poses, and game characters, or about `max_count` of each kind, evenly spread."""
    for number in spread(list(range(BOUND_IN)), max_count):
        yield from _generate(number)
    packs = [sorted(pack.glob("*.glb")) for pack in sorted((data / "characters" / "game").glob("*"))]
    chosen = list(chain.from_iterable(spread(pack, OF_PACK) for pack in packs))
    for path in spread(chosen, max_count):
        yield from _of_game(path)


def take(armature: Object, stance: Stance) -> None:
    """Put an armature into a pose."""
    for bone in armature.pose.bones:
        bone.matrix_basis = stance.get(bone.name, Matrix())
    bpy.context.view_layer.update()


def bone_matrices(armature: Object, names: tuple[str, ...]) -> Floats:
    """(b, 4, 4) transforms of bones from the rest pose to the armature's current pose, in world space."""
    world = armature.matrix_world
    return np.array(
        [
            world
            @ armature.pose.bones[name].matrix
            @ armature.data.bones[name].matrix_local.inverted()
            @ world.inverted()
            for name in names
        ]
    )


def weights_of(source: Object, names: tuple[str, ...]) -> csr_array:
    """(n, b) the weights of bones, which sum to one."""
    groups = mesh_data.read_weights(source, source.data)
    weights = np.zeros((len(source.data.vertices), len(names)))
    for number, name in enumerate(names):
        if name in groups.labels:
            weights[:, number] = groups.values[:, [groups.labels.index(name)]].toarray()[:, 0]
    return csr_array(weights / np.maximum(weights.sum(axis=1, keepdims=True), np.finfo(float).tiny))


def positions(obj: Object) -> Floats:
    """(n, 3) world positions of an object's evaluated vertices."""
    with mesh_data.evaluated_mesh(obj, bpy.context.evaluated_depsgraph_get()) as (evaluated, mesh):
        return mesh_data.positions_in_world(evaluated, mesh_data.read_positions(mesh).astype(np.float64))


def _generate(number: int) -> Iterator[Case]:
    """The demo's character, in the demo's pose, or one drawn at random."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    character, armature = build_character(CELL)
    character.modifiers.remove(character.modifiers["Corrective Smooth"])  # the bones define the truth
    random = np.random.default_rng(number)

    def draw_stance() -> Stance:
        set_pose(armature, {name: tuple(random.normal(0, TURN, 3)) for name in POSE})
        return _stance(armature)

    stances = [draw_stance() for _ in range(TAKEN + 1)]
    set_pose(armature)
    bound_in = _stance(armature) if number == 0 else stances[0]
    yield from _cases(GENERATED, f"character, pose {number}", character, armature, bound_in, tuple(stances[1:]))


def _of_game(path: Path) -> Iterator[Case]:
    """A game character in the frame that differs most from its rest pose."""
    character = read_character(path)
    if is_broken(character):
        return
    armature = next(obj for obj in bpy.data.objects if obj.type == "ARMATURE")
    bound_in = _stance(armature)
    taken = [_swung(bound_in)]
    if bpy.data.actions and armature.animation_data is not None:
        taken = []
        for frame in spread(list(all_frames()), TAKEN):
            set_frame(armature, *frame)
            taken.append(_stance(armature))
    armature.animation_data_clear()
    for obj in [obj for obj in bpy.data.objects if obj.type == "MESH"]:
        bpy.data.objects.remove(obj)
    mesh = bpy.data.meshes.new("Source")
    mesh.from_pydata(character.rest.vertices, [], character.rest.triangles)
    source = bpy.data.objects.new("Source", mesh)
    bpy.context.scene.collection.objects.link(source)
    names = character.skeleton.names
    weights = Attribute("vertex groups", Domain.POINT, Kind.WEIGHT, csr_array(character.rest.weights), names)
    mesh_data.write_weights(source, weights)
    source.modifiers.new("Armature", "ARMATURE").object = armature
    yield from _cases(
        GAME, f"{character.pack} {character.name}, {character.pose}", source, armature, bound_in, tuple(taken)
    )


def _swung(stance: Stance) -> Stance:
    """Another pose for characters without animation: all rotations are inverted."""
    return {
        name: Matrix.LocRotScale(basis.translation, basis.to_quaternion().inverted(), basis.to_scale())
        for name, basis in stance.items()
    }


def _stance(armature: Object) -> Stance:
    return {bone.name: bone.matrix_basis.copy() for bone in armature.pose.bones}


def _cases(
    kind: str, name: str, source: Object, armature: Object, bound_in: Stance, taken: tuple[Stance, ...]
) -> Iterator[Case]:
    """A case for each way of remeshing the posed source."""
    take(armature, bound_in)
    posed = positions(source)
    take(armature, {})
    surface = mesh_data.read_source_surface(source, bpy.context.evaluated_depsgraph_get())
    count = max(FEWEST, round(THINNED * len(posed)))
    skin = one_skin(Body(posed, surface.triangles, np.ones((len(posed), 1), np.float32)))
    for mesh, target in (
        ("isotropic", isotropic(surface.with_vertices(posed), count, np.random.default_rng(0))),
        ("voxels", zo.Surface(skin.vertices, skin.triangles)),
    ):
        truth = zo.SurfaceMap(*closest_points(target.vertices, posed, surface.triangles), surface.triangles)
        yield Case(kind, name, mesh, source, armature, target, truth, bound_in, taken)
