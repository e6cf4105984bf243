# SPDX-License-Identifier: GPL-3.0-or-later
"""Avatars in files that Blender opens, dressed in the clothes of others, for `zoomout_core.outfits`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from bpy.types import Context, Object
from scipy.sparse import csr_array, vstack

import zoomout_core as zo
from zoomout_core.arrays import Floats
from zoomout_core.maps.known_match import KnownMatch
from zoomout_core.mesh.affine_maps import normalise
from zoomout_core.mesh.formats.blender_files import BLEND
from zoomout_core.messages import warning
from zoomout_core.outfits.check import RiggedSurface, check_rigged
from zoomout_core.outfits.dress_file import DressedFile
from zoomout_core.outfits.parts import are_of_body, is_hair
from zoomout_core.transfer import Skeleton
from zoomout_core.transfer.dressing.missing_skin import DEPTH, complete_body
from zoomout_core.transfer.rigging.joint_map import RiggedBody

from .. import mesh_data
from ..jobs import run
from ..mesh_data import Bones
from ..scene.files import Brought, keep_as_blend, open_scene, save_scene, shown_meshes
from ..scene.pair import find_mesh, fingerprint_source, fingerprint_target
from ..storage import stored_candidates, stored_match
from .binding.read import weights_of_bones
from .dressing.dress import prepare_dress
from .dressing.read import Dressing
from .matching.collection_match import prepare_parts
from .matching.joined_match import Parts
from .matching.made_match import MatchUse

# Extensions of avatar files.
ENDINGS = (BLEND, ".fbx", ".glb", ".gltf")


@dataclass(frozen=True, eq=False)
class _Avatar:
    """The visible objects of an open file.

    Attributes:
        body: surfaces of the parts of the body by the names of their objects.
        worn: names of the objects that it wears.
    """

    body: Mapping[str, zo.Surface]
    worn: Sequence[str]

    @property
    def joined(self) -> zo.Surface:
        """The body as one surface, of Blender's triangles."""
        whole = zo.Surface.joined(list(self.body.values()))
        return zo.Surface(whole.vertices, whole.triangles)

    @property
    def largest(self) -> str:
        """The name of the part of the body with the largest area."""
        return max(self.body, key=lambda name: self.body[name].area)


class _Wearing(NamedTuple):
    """Names of the objects of a dressed body in the scene."""

    body: Sequence[str]
    worn: Sequence[str]
    largest: str  # the part of the body with the largest area


@dataclass(frozen=True)
class BlenderFiles:
    """Avatars in files that Blender opens, and how they are dressed: `zoomout_core.outfits.dress_file.AvatarFiles`.

    Attributes:
        context: Blender's; each file replaces the open one.
        dressing: how they are dressed.
        body: patterns of the names of objects or materials of bodies; by words in these names, when not given.
        force: whether to write avatars even if the match is probably wrong.
        format: extension of the files to write; that of the avatar if empty.
    """

    context: Context = field(repr=False)
    dressing: Dressing
    body: tuple[str, ...] = ()
    force: bool = False
    format: str = ""

    def read_body(self, path: Path, wears: bool) -> zo.Surface:
        """See `AvatarFiles`."""
        return self._open(path, wears).joined

    def read_rigged(self, path: Path, wears: bool) -> RiggedBody | None:
        """See `AvatarFiles`; None also if modifiers change the number of vertices."""
        avatar = self._open(path, wears)
        shown, bones = avatar.joined, mesh_data.read_bones(find_mesh(self.context, avatar.largest))
        objects = [find_mesh(self.context, name) for name in avatar.body]
        rest = self._upright(list(avatar.body), True).vertices
        if not bones.names or not len(rest) == len(shown.vertices) == sum(len(each.data.vertices) for each in objects):
            return None
        skeleton = Skeleton(bones.names, bones.parents, _y_up(bones.heads))
        return RiggedBody(shown.with_vertices(rest), skeleton, _weights(objects, bones))

    def ending(self, avatar: Path) -> str:
        """See `AvatarFiles`."""
        return self.format or avatar.suffix.lower()

    def dress(self, outfit: Path, avatar: Path, map_file: Path, output: Path) -> DressedFile:
        """See `AvatarFiles`."""
        source = self._open(outfit, True)
        with keep_as_blend(outfit) as library:
            target = self._open(avatar, False)
            brought = Brought(self.context, library, [*source.body, *source.worn])
        bodies, worn = brought.names[: len(source.body)], brought.names[len(source.body) :]
        wearer = find_mesh(self.context, target.largest)
        main = self._store_match(source, bodies, target, map_file)
        before = _count_bones(wearer)
        report = run(prepare_dress(self.context, main, wearer.name, worn, self.dressing, MatchUse(force=True)))()
        joints = _count_bones(wearer) - before
        dressed = _Wearing(list(target.body), target.worn, wearer.name)
        made = self._check(_Wearing(bodies, worn, main), dressed, report["objects"])
        for name in target.body:  # their matches refer to objects of another file
            stored_match.remove(find_mesh(self.context, name).data)
            stored_candidates.remove(find_mesh(self.context, name).data)
        brought.remove(self.context, [*target.body, *report["objects"].values()])
        save_scene(output, [outfit, avatar])
        notes = [*report["left_out"].values(), *report["notes"]]
        if len(target.body) > 1:
            notes.append(
                warning(
                    "The body has {count} objects, and the clothes follow '{name}', the largest one: check those on "
                    "the others.",
                    count=len(target.body),
                    name=wearer.name,
                )
            )
        return made._replace(joints=joints, notes=tuple(notes))

    def _open(self, path: Path, wears: bool) -> _Avatar:
        """Open a file, and separate its body from the objects that it wears."""
        if path.suffix.lower() not in ENDINGS:
            raise zo.MeshError(f"{path} is not an avatar that Blender can read: convert it to {', '.join(ENDINGS)}.")
        open_scene(self.context, path)
        meshes = shown_meshes(self.context.view_layer.objects)
        if not meshes:
            raise zo.MeshError(f"{path} has no visible mesh with faces: make its body and clothes visible.")
        found = [find_mesh(self.context, name) for name in meshes]
        names = [_names_of(obj) for obj in found]
        of_body = are_of_body([(name, *materials) for name, materials in names], self.body, wears=wears)
        depsgraph = self.context.evaluated_depsgraph_get()
        body = {
            obj.name: mesh_data.read_target_surface(obj, depsgraph)
            for obj, chosen in zip(found, of_body, strict=True)
            if chosen
        }
        curves = [obj.name for obj in self.context.view_layer.objects if obj.type == "CURVES" and obj.visible_get()]
        return _Avatar(body, [*(name for name in meshes if name not in body), *sorted(curves)])

    def _store_match(self, source: _Avatar, bodies: Sequence[str], target: _Avatar, map_file: Path) -> str:
        """Store the match of two bodies on the target's objects; returns the source of the largest one."""
        known = KnownMatch.load(map_file, source.joined, target.joined)
        sources = Parts.of(
            [fingerprint_source(self.context, name, at_base=True) for name in bodies], list(source.body.values())
        )
        targets = Parts.of([fingerprint_target(self.context, name) for name in target.body], list(target.body.values()))
        return run(prepare_parts(self.context, sources, targets, known))()[target.largest][0]

    def _check(self, source: _Wearing, target: _Wearing, copies: Mapping[str, str]) -> DressedFile:
        """Check the copies that a target wears, by the names of their originals."""
        objects = self.context.scene.objects
        worn = {original: copy for original, copy in copies.items() if _has_faces(objects[copy])}
        at_rest = all(mesh_data.armatures_of(objects[each.largest]) for each in (source, target))
        bones = mesh_data.read_bones(objects[target.largest])
        before, body = self._complete(source, at_rest, DEPTH).surface, self._complete(target, at_rest, 0.0)
        clothes, cloth = self._upright(list(worn), at_rest), self._rig_of(list(worn.values()), at_rest, bones)
        counts = tuple((name, len(objects[name].data.vertices)) for name in worn.values())
        checked = check_rigged(before, clothes, cloth, body, _y_up(bones.heads))
        return DressedFile(checked, (body.surface.triangles, cloth.surface.triangles), counts, 0, ())

    def _complete(self, wearing: _Wearing, at_rest: bool, depth: float) -> RiggedSurface:
        """A body, completed by clothes without skin below them, see `complete_body`, and how bones move it."""
        objects = self.context.scene.objects
        bones = mesh_data.read_bones(objects[wearing.largest])
        body = self._rig_of(wearing.body, at_rest, bones)
        if body.weights is None:
            return body
        names = [name for name in wearing.worn if _has_faces(objects[name]) and not is_hair(*_names_of(objects[name]))]
        surfaces = [self._upright([name], at_rest) for name in names]
        weights = [_weights([objects[name]], bones) for name in names]
        skeleton = Skeleton(bones.names, bones.parents, _y_up(bones.heads))
        clothed = complete_body(RiggedBody(body.surface, skeleton, body.weights), surfaces, weights, depth)
        if clothed is None:
            return body
        return RiggedSurface(clothed.body.surface, bones.parents, clothed.body.weights)

    def _rig_of(self, names: Sequence[str], at_rest: bool, bones: Bones) -> RiggedSurface:
        """The surface of some objects, and how bones move it."""
        surface = self._upright(names, at_rest)
        if not bones.names:
            return RiggedSurface(surface, None, None)
        return RiggedSurface(
            surface, bones.parents, _weights([self.context.scene.objects[name] for name in names], bones)
        )

    def _upright(self, names: Sequence[str], at_rest: bool) -> zo.Surface:
        """The surface of some objects, undeformed or as displayed, with y up."""
        depsgraph, found = self.context.evaluated_depsgraph_get(), list[zo.Surface]()
        for name in names:
            shape = mesh_data.read_worn(self.context.scene.objects[name], depsgraph, at_rest).shape
            assert isinstance(shape, zo.Surface)
            found.append(shape.with_vertices(_y_up(shape.vertices)))
        return zo.Surface.joined(found)


def _count_bones(obj: Object) -> int:
    """The number of bones of an object's armatures."""
    return sum(len(armature.data.bones) for armature in mesh_data.armatures_of(obj))


def _names_of(obj: Object) -> tuple[str, list[str]]:
    """The names of an object and of its materials."""
    return obj.name, [slot.material.name for slot in obj.material_slots if slot.material]


def _has_faces(obj: Object) -> bool:
    return obj.type == "MESH" and bool(obj.data.polygons)


def _y_up(points: Floats) -> Floats:
    """Points (n, 3) of Blender, where z is up and characters look along -y, with y up, looking along z."""
    return points[:, [0, 2, 1]] * [1, 1, -1]


def _weights(objects: Sequence[Object], bones: Bones) -> csr_array:
    """(n, b) weights of bones of all vertices of some objects; without any, those of the parent bone or the root."""
    found = []
    for obj in objects:
        groups = mesh_data.read_weights(obj, obj.data)
        weights = csr_array((len(obj.data.vertices), len(bones.names)))
        if set(groups.labels) & set(bones.names):
            weights = weights_of_bones([groups], bones)
        parent = bones.names.index(obj.parent_bone) if obj.parent_bone in bones.names else 0
        lacking = np.flatnonzero(weights.sum(axis=1) == 0)
        rest = (np.ones(len(lacking)), (lacking, np.full(len(lacking), parent)))
        found.append(normalise(csr_array(weights + csr_array(rest, shape=weights.shape))))
    return csr_array(vstack(found, format="csr"))
