# SPDX-License-Identifier: GPL-3.0-or-later
"""An object's mesh with all its data as an asset, and objects for its levels of detail."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np
from bpy.types import Object
from scipy.sparse import csr_array, diags_array

from zoomout_core.arrays import Floats
from zoomout_core.assets.asset import MATERIALS, NORMALS, SHAPE_KEYS, UV, Asset, Skin
from zoomout_core.assets.level import Level
from zoomout_core.maps.surface_map import interpolation_matrix
from zoomout_core.mesh.affine_maps import normalise
from zoomout_core.mesh.errors import MeshError
from zoomout_core.transfer.attribute import Attribute, Domain, Kind

from ..arrays import read_array
from ..attributes.layers import (
    ActiveLayers,
    Layer,
    Role,
    is_bookkeeping,
    read_active_layers,
    read_layers,
    write_active_layers,
    write_layer,
)
from ..attributes.normals import read_own_normals, write_custom_normals
from ..attributes.vertex_groups import read_weights, write_weights
from ..keys.key_drivers import Partners, redirect_drivers
from ..keys.shape_keys import ShapeKeys, read_own_shape_keys, read_rest_positions
from ..keys.write_keys import write_animation, write_shape_keys
from ..matrices import transform_points, world_matrix
from ..rigs.armatures import Bones, read_bones
from ..surfaces.surfaces import is_mirrored, positions_in_object, read_surface_at_rest

SMOOTH = "smooth"


@dataclass(frozen=True, eq=False)
class DetailedMesh:
    """The mesh of an object, in its own space at rest, and the data that its levels take from it.

    Attributes:
        asset: the mesh; its layers have the names "uv 0" or "layer 0" with their numbers.
        layers: its attributes but those of edges.
        active: which of these are active.
        weights: all vertex groups.
        keys: the shape keys; None if there are none.
        left_out: names of attributes that levels do not have.
    """

    asset: Asset
    layers: tuple[Layer, ...]
    active: ActiveLayers
    weights: Attribute
    keys: ShapeKeys | None
    left_out: tuple[str, ...]


def read_detailed_mesh(obj: Object) -> DetailedMesh:
    """Read the mesh of an object before its modifiers.

    Raises:
        MeshError: there is no surface.
    """
    mesh = obj.data
    rest = read_rest_positions(mesh)
    found, skipped = read_layers(mesh)
    layers = tuple(layer for layer in found if layer.attribute.domain is not Domain.EDGE)
    on_edges = (layer.attribute.name for layer in found if layer.attribute.domain is Domain.EDGE)
    left_out = tuple(name for name in (*skipped, *on_edges) if not is_bookkeeping(name))
    attributes = [replace(layer.attribute, name=_name_in_asset(number, layer)) for number, layer in enumerate(layers)]
    slots = read_array(mesh.polygons, "material_index", np.int32).astype(np.int64)
    smooth = read_array(mesh.polygons, "use_smooth", bool).astype(np.int64)
    attributes += [
        Attribute(MATERIALS, Domain.FACE, Kind.LABEL, slots),
        Attribute(SMOOTH, Domain.FACE, Kind.LABEL, smooth),
    ]
    if mesh.normals_domain == "CORNER":
        attributes.append(replace(read_own_normals(mesh), name=NORMALS))
    keys = None
    if mesh.shape_keys is not None and len(mesh.shape_keys.key_blocks) > 1:
        keys = read_own_shape_keys(mesh)
        attributes.append(replace(keys.offsets, name=SHAPE_KEYS))
    weights, bones = read_weights(obj, mesh), read_bones(obj)
    asset = Asset(read_surface_at_rest(obj, positions=rest), tuple(attributes), skin=_skin(obj, rest, weights, bones))
    return DetailedMesh(asset, layers, read_active_layers(mesh), weights, keys, left_out)


def read_given_level(given: Object, obj: Object) -> Asset:
    """The shape at rest of a mesh that is to be a level of an object, and its UV maps, in the object's space.

    Raises:
        MeshError: there is no surface, or it is mirrored relative to the object.
    """
    mesh = given.data
    if is_mirrored(given) != is_mirrored(obj):
        raise MeshError(
            "'{name}' is mirrored by a negative scale: apply it first, with Object > Apply > Scale.", name=given.name
        )
    placed = positions_in_object(obj, transform_points(world_matrix(given), read_rest_positions(mesh)))
    maps = [layer.attribute for layer in read_layers(mesh)[0] if layer.role is Role.UV_MAP]
    named = [replace(each, name=f"{UV} {number}") for number, each in enumerate(maps)]
    return Asset(read_surface_at_rest(given, positions=placed), tuple(named))


def add_level(obj: Object, name: str, detailed: DetailedMesh, level: Level) -> Object:
    """A copy of an object with the mesh of a level, outside any collection."""
    asset, source = level.asset, obj.data
    mesh = bpy.data.meshes.new(name)
    surface = asset.surface
    mesh.from_pydata(surface.vertices, [], np.split(surface.corner_vertex, surface.face_start[1:-1]))
    for material in source.materials:
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", _values(asset, MATERIALS).astype(np.int32))
    mesh.polygons.foreach_set("use_smooth", _values(asset, SMOOTH).astype(bool))
    for number, layer in enumerate(detailed.layers):
        values = _values(asset, _name_in_asset(number, layer))
        write_layer(mesh, replace(layer, attribute=replace(layer.attribute, values=values)))
    write_active_layers(mesh, detailed.active)
    made = obj.copy()
    made.data, made.name = mesh, name
    if detailed.keys is not None:
        write_shape_keys(made, detailed.keys.keys, _values(asset, SHAPE_KEYS))
        write_animation(source.shape_keys, mesh.shape_keys, [key.name for key in detailed.keys.keys])
        redirect_drivers(mesh.shape_keys, Partners({source.shape_keys: mesh.shape_keys}))
    write_weights(made, replace(detailed.weights, values=_weights(detailed, level)))
    mesh.update()
    normals = asset.find(NORMALS)
    if normals is not None:
        write_custom_normals(mesh, normals)
    return made


def _weights(detailed: DetailedMesh, level: Level) -> csr_array:
    """(k, groups) weights of a level: those of its joints, with the mesh's sums, and other groups as in the mesh."""
    found, mesh_weights = level.match.surface_map, csr_array(detailed.weights.values).astype(np.float64)
    corners = found.source_triangles[found.triangle]
    own = csr_array(interpolation_matrix(corners, found.barycentric, mesh_weights.shape[0]) @ mesh_weights)
    own.eliminate_zeros()
    skin = level.asset.skin
    if skin is None:
        return own
    groups, joints = _groups_of_joints(detailed.weights.labels, skin.names)
    moving = np.isin(np.arange(own.shape[1]), groups)
    place = csr_array((np.ones(len(groups)), (joints, groups)), shape=(len(skin.names), own.shape[1]))
    fitted = diags_array(own @ moving.astype(float)) @ csr_array(skin.weights) @ place
    weights = csr_array(own @ diags_array((~moving).astype(float)) + fitted)
    weights.eliminate_zeros()
    return weights


def _groups_of_joints(labels: Sequence[str], names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """The numbers (p,) of groups that bones have, and the numbers (p,) of these bones."""
    columns = {name: number for number, name in enumerate(labels)}
    pairs = [(columns[name], number) for number, name in enumerate(names) if name in columns]
    groups, joints = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    return groups, joints


def _name_in_asset(number: int, layer: Layer) -> str:
    return f"{UV} {number}" if layer.role is Role.UV_MAP else f"layer {number}"


def _values(asset: Asset, name: str) -> np.ndarray:
    attribute = asset.find(name)
    assert attribute is not None
    return np.asarray(attribute.values)


def _skin(obj: Object, rest: Floats, weights: Attribute, bones: Bones) -> Skin | None:
    """The bones as joints at rest; vertices without weights move with a bone that has no parent, instead of resting."""
    groups, numbers = _groups_of_joints(weights.labels, bones.names)
    if not len(groups):
        return None
    place = csr_array((np.ones(len(groups)), (groups, numbers)), shape=(len(weights.labels), len(bones.names)))
    own = csr_array(csr_array(weights.values).astype(np.float64) @ place)
    without = np.flatnonzero(np.asarray(own.sum(axis=1)).ravel() <= 0)
    if len(without) == len(rest):
        return None
    root = np.full(len(without), int(np.flatnonzero(bones.parents < 0)[0]))
    own = normalise(csr_array(own + csr_array((np.ones(len(without)), (without, root)), shape=own.shape)))
    inverse_bind = np.tile(np.eye(4), (len(bones.names), 1, 1))
    inverse_bind[:, :3, 3] = -positions_in_object(obj, bones.heads)
    still = np.tile(np.eye(4), (len(bones.names), 1, 1))
    linear = np.tile(np.eye(3), (len(rest), 1, 1))
    return Skin(np.arange(len(bones.names)), bones.names, bones.parents, inverse_bind, still, rest, linear, own)
