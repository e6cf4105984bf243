# SPDX-License-Identifier: GPL-3.0-or-later
"""Several objects read as one: their elements are concatenated, and data of the same name becomes one layer.

Where an object lacks a layer, its elements have no weight, no mark, no offset, or a value of zero.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import astuple, replace
from typing import NamedTuple

import numpy as np
from bpy.types import Mesh, Object
from scipy.sparse import csr_array, vstack

import zoomout_core as zo
from zoomout_core.arrays import Floats
from zoomout_core.messages import message
from zoomout_core.transfer import Attribute, Domain
from zoomout_core.transfer.attribute import nothing

from ..attributes.layers import ActiveLayers, Layer, Role, read_active_layers, read_layer, read_layers
from ..attributes.marks import read_marks
from ..attributes.materials import read_materials
from ..attributes.normals import read_normals
from ..attributes.vertex_groups import read_weights
from .surfaces import read_surface_at_rest

ELEMENTS = {Domain.POINT: "vertices", Domain.EDGE: "edges", Domain.FACE: "polygons", Domain.CORNER: "loops"}


class EvaluatedObject(NamedTuple):
    """An object and its evaluated state.

    Attributes:
        original: the object as it is in the file.
        evaluated: the object after its modifiers.
        mesh: the evaluated mesh.
    """

    original: Object
    evaluated: Object
    mesh: Mesh


class JoinedLayer(NamedTuple):
    """A layer that some or all of several objects have.

    Attributes:
        layer: values of all their elements.
        lacking: numbers of the objects that do not have it.
    """

    layer: Layer
    lacking: tuple[int, ...]


def read_joined_layers(
    objects: Sequence[EvaluatedObject], turning: Collection[str] = ()
) -> tuple[list[JoinedLayer], dict[str, str]]:
    """`read_layers` of several objects; their active UV maps become one, named like the first."""
    shown, skipped = read_joined_active_layers(objects).uv, dict[str, str]()
    found: list[dict[str, Layer]] = []
    for obj in objects:
        layers, reasons = read_layers(obj.mesh, turning)
        found.append(_with_shown_as(shown, obj.mesh, {layer.attribute.name: layer for layer in layers}))
        skipped = reasons | skipped
    joined = []
    for name in dict.fromkeys(name for layers in found for name in layers):
        first = next(layers[name] for layers in found if name in layers)
        parts = [layers.get(name) for layers in found]
        for obj, part in zip(objects, parts, strict=True):
            if part is not None and not _alike(part, first):
                skipped[message("{layer} of '{name}'", layer=name, name=obj.original.name)] = (
                    "it has another type on other objects"
                )
        of_one_type = [part if part is not None and _alike(part, first) else None for part in parts]
        joined.append(
            JoinedLayer(
                replace(first, attribute=_join([part and part.attribute for part in of_one_type], objects)),
                tuple(number for number, part in enumerate(of_one_type) if part is None),
            )
        )
    return joined, skipped


def read_joined_active_layers(objects: Sequence[EvaluatedObject]) -> ActiveLayers:
    """The shown and rendered layers, each from the first object that has one."""
    of_each = [astuple(read_active_layers(obj.mesh)) for obj in objects]
    return ActiveLayers(*(next(filter(None, names), None) for names in zip(*of_each, strict=True)))


def read_joined_active_uv_map(objects: Sequence[EvaluatedObject]) -> Attribute:
    """The active UV maps of the objects, as one.

    Raises:
        MeshError: no object has a UV map, or all UVs are at one point.
    """
    name = read_joined_active_layers(objects).uv
    if name is None:
        raise zo.MeshError(
            "'{source}' has no UV map: unwrap it, or choose another source.", source=objects[0].original.name
        )
    parts = []
    for obj in objects:
        own = name if name and name in obj.mesh.uv_layers else read_active_layers(obj.mesh).uv
        parts.append(own and replace(read_layer(obj.mesh, own, Role.UV_MAP).attribute, name=name))
    joined = _join([part or None for part in parts], objects)
    if not np.ptp(joined.values, axis=0).any():
        raise zo.MeshError(
            "All UVs of '{uv_map}' are at one point: unwrap the source, or activate another of its UV maps.",
            uv_map=name,
        )
    return joined


def read_joined_uv(objects: Sequence[EvaluatedObject], name: str | None) -> Floats:
    """(c, 2) the UV map of a name of each object, or the one that renders show; zero where there is none."""
    parts = []
    for obj in objects:
        own = name if name and name in obj.mesh.uv_layers else read_active_layers(obj.mesh).uv_render
        found = read_layer(obj.mesh, own, Role.UV_MAP).attribute.values if own else np.zeros((len(obj.mesh.loops), 2))
        parts.append(np.asarray(found, dtype=np.float64))
    return np.concatenate(parts)


def read_joined_marks(objects: Sequence[EvaluatedObject]) -> list[Attribute]:
    """`read_marks` of several objects."""
    found = [{marks.name: marks for marks in read_marks(obj.mesh)} for obj in objects]
    names = dict.fromkeys(name for marks in found for name in marks)
    return [_join([marks.get(name) for marks in found], objects) for name in names]


def read_joined_materials(objects: Sequence[EvaluatedObject]) -> tuple[list[str | None], Attribute, tuple[int, ...]]:
    """The names of the materials of several objects, each face's index in that list, and which objects have none.

    The indices of faces without materials have no meaning.
    """
    found = [read_materials(obj.evaluated, obj.mesh) for obj in objects]
    first = np.cumsum([0, *(len(names) for names, _ in found)])
    slots = np.concatenate([slots.values + start for (_, slots), start in zip(found, first, strict=False)])
    lacking = tuple(number for number, (names, _) in enumerate(found) if not names)
    every = [name for names, _ in found for name in names]
    present = list(dict.fromkeys(every))
    place = np.array([present.index(name) for name in every] or [0])
    return present, replace(found[0][1], values=place[np.minimum(slots, len(place) - 1)]), lacking


def read_joined_weights(objects: Sequence[EvaluatedObject]) -> tuple[Attribute, tuple[int, ...]]:
    """The weights of several objects, with groups joined by name, and which objects have none."""
    found = [read_weights(obj.evaluated, obj.mesh) for obj in objects]
    lacking = tuple(number for number, weights in enumerate(found) if weights.values.nnz == 0)
    if len(found) == 1:
        return found[0], ()
    labels = tuple(dict.fromkeys(label for weights in found for label in weights.labels))
    number = {label: column for column, label in enumerate(labels)}
    widened = []
    for weights in found:
        values = csr_array(weights.values)
        column = np.array([number[label] for label in weights.labels], dtype=np.int64)
        shape = values.shape[0], len(labels)
        widened.append(csr_array((values.data, column[values.indices], values.indptr), shape=shape))
    return replace(found[0], values=csr_array(vstack(widened, format="csr")), labels=labels), lacking


def read_joined_normals(objects: Sequence[EvaluatedObject]) -> Attribute | None:
    """The corner normals of several objects in world space, if any object has custom ones."""
    if not any(obj.mesh.has_custom_normals for obj in objects):
        return None
    return _join([read_normals(obj.evaluated, obj.mesh) for obj in objects], objects)


def read_joined_at_rest(objects: Sequence[EvaluatedObject]) -> zo.Surface:
    """`read_surface_at_rest` of several objects, each in its mesh's own space."""
    surfaces = [read_surface_at_rest(obj.original, obj.mesh) for obj in objects]
    return surfaces[0] if len(surfaces) == 1 else zo.Surface.joined(surfaces)


def _with_shown_as(name: str | None, mesh: Mesh, layers: dict[str, Layer]) -> dict[str, Layer]:
    """Layers of a mesh, with the active UV map renamed, unless another layer has the name."""
    own = read_active_layers(mesh).uv
    if name is None or name in layers or own not in layers:
        return layers
    renamed = replace(layers[own], attribute=replace(layers[own].attribute, name=name))
    return {name: renamed} | {other: layer for other, layer in layers.items() if other != own}


def _alike(layer: Layer, other: Layer) -> bool:
    """Whether two layers can be joined."""
    return (layer.role, layer.data_type, layer.attribute.domain) == (
        other.role,
        other.data_type,
        other.attribute.domain,
    )


def _join(parts: Sequence[Attribute | None], objects: Sequence[EvaluatedObject]) -> Attribute:
    """Join an attribute of several objects, some of which may lack it."""
    present = next(part for part in parts if part is not None)
    if len(parts) == 1:
        return present
    values = [
        nothing(present.values, len(getattr(obj.mesh, ELEMENTS[present.domain]))) if part is None else part.values
        for part, obj in zip(parts, objects, strict=True)
    ]
    return replace(present, values=np.concatenate(values))
