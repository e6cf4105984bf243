# SPDX-License-Identifier: GPL-3.0-or-later
"""A filter that transfers attributes between layers with different poses and topologies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

import zoomout_core as zo
from meshlab_filter.catalogue import mesh_filter
from meshlab_filter.filters.match_parameters import MATCHING, SOURCE, STORED_OR_NEW, TARGET
from meshlab_filter.filters.matches import find_correspondence
from meshlab_filter.layer import TEXCOORD, Layer
from meshlab_filter.mesh_data import add_layer, check_target, custom_names, read_layer, turn_normals
from meshlab_filter.parameters import NAMES, SWITCH, Parameter
from meshlab_filter.stored import Correspondence
from zoomout_core.messages import warning
from zoomout_core.runtime.progress import portion, stage
from zoomout_core.transfer import Attribute, Domain, Kind, transfer

if TYPE_CHECKING:
    from pymeshlab import MeshSet

# The name of the image that MeshLab shows in place of one that it cannot read.
DUMMY = "dummy.png"
NORMAL = "vertex_normal"
# Selects all custom attributes of the source.
ALL = "*"


@mesh_filter(
    SOURCE,
    TARGET,
    Parameter("texcoordtransfer", SWITCH, True, "Texture coordinates of wedges (otherwise of vertices), and textures."),
    Parameter("colortransfer", SWITCH, True, "Colours of vertices and faces."),
    Parameter("qualitytransfer", SWITCH, True, 'Scalars ("quality") of vertices and faces.'),
    Parameter("normaltransfer", SWITCH, False, "Normals of vertices, rotated with the surface."),
    Parameter("selectiontransfer", SWITCH, False, "Selections of vertices and faces."),
    Parameter(
        "customattributes", NAMES, (), "Names of custom attributes, separated by commas in a script; '*' for all."
    ),
    STORED_OR_NEW,
    *MATCHING,
)
def transfer_attributes_by_zoomout(
    ms: MeshSet,
    *,
    sourcemesh: int,
    targetmesh: int,
    texcoordtransfer: bool,
    colortransfer: bool,
    qualitytransfer: bool,
    normaltransfer: bool,
    selectiontransfer: bool,
    customattributes: Sequence[str],
    correspondence: str,
    **matching: Any,
) -> dict[str, Any]:
    """Transfer attributes between corresponding meshes with different poses and topologies.

    The result is a new layer, which becomes current: a copy of the target on which the source's attributes
    replace its own. Source and target are not changed, and on an error there is no new
    layer. If the source has texture coordinates, polygons of the target become triangles in the new layer,
    because MeshLab cannot save texture coordinates of polygons.

    Returns:
        `mesh_id` of the new layer; `transferred`, names; `confidence`, an array with a value in [0, 1] for each
        vertex; `candidates`, each with its origin, whether it reverses
        orientation, and its scores, and `certainty` (both unless the correspondence was stored); `notes`,
        sentences for the user.

    Raises:
        MeshError: a mesh that is missing or cannot be used; the message says what to do.
        ValueError: arguments that do not fit together.
    """
    wanted = {
        TEXCOORD: texcoordtransfer,
        "vertex_color": colortransfer,
        "face_color": colortransfer,
        "vertex_scalar": qualitytransfer,
        "face_scalar": qualitytransfer,
        "vertex_selection": selectiontransfer,
        "face_selection": selectiontransfer,
        NORMAL: normaltransfer,
    }
    source = read_layer(ms, sourcemesh, _check_custom_names(ms, sourcemesh, customattributes))
    target = read_layer(ms, targetmesh, custom_names(ms, targetmesh))
    missing = [] if TEXCOORD in source.components or not texcoordtransfer else [TEXCOORD]
    source = _select_components(source, wanted)
    check_target(target)
    source, homeless = _supported_layer(target, source)

    with portion(0.0, 0.8):
        found, report = find_correspondence(ms, source, target, targetmesh, correspondence, **matching)
    with portion(0.8, 1.0):
        received = _transfer(source, target, found)
    new = _merge(target, source, received)
    notes = [note for attribute in received for note in attribute.notes]
    notes += [f"Layer '{source.label}' has no {name}." for name in missing]
    notes += [f"Layer '{target.label}' has no faces, so {name} cannot be transferred to it." for name in homeless]
    return {
        **report,
        "mesh_id": add_layer(ms, new),
        "transferred": [attribute.name for attribute in received],
        "notes": [*report["notes"], *notes, *_notes(target, new)],
    }


def _select_components(source: Layer, wanted: dict[str, bool]) -> Layer:
    """The source with its wanted components, by their names.

    Raises:
        MeshError: it has none of them, and no custom attributes.
    """
    components = {name: a for name, a in source.components.items() if wanted[name]}
    if wanted["vertex_selection"]:  # an empty selection is transferred as one
        components = _selections(source) | components
    if wanted[NORMAL]:
        components[NORMAL] = _normals(source)
    if not components and not source.custom:
        raise zo.MeshError(
            f"Layer '{source.label}' has none of the attributes to transfer: check which mesh is the source, or "
            "choose others."
        )
    return replace(source, components=components)


def _supported_layer(target: Layer, source: Layer) -> tuple[Layer, list[str]]:
    """The source with the attributes that a target can store, and the names of those that it cannot.

    Raises:
        MeshError: the target can store none of them.
    """
    components = {name: a for name, a in source.components.items() if target.can_hold(a)}
    custom = tuple(a for a in source.custom if target.can_hold(a))
    homeless = [a.name for a in (*source.components.values(), *source.custom) if not target.can_hold(a)]
    if not components and not custom:
        raise zo.MeshError(
            f"Layer '{target.label}' has no faces to receive {' and '.join(homeless)} of '{source.label}': choose a "
            "target with faces, or transfer vertex attributes."
        )
    return replace(source, components=components, custom=custom), homeless


def _check_custom_names(ms: MeshSet, mesh_id: int, names: str | Sequence[str] | None) -> list[str]:
    """The names of the custom attributes that a user requested."""
    if names == ALL:
        return custom_names(ms, mesh_id)
    if isinstance(names, str):
        names = [name.strip() for name in names.split(",")]
    return [name for name in names or () if name]


def _transfer(source: Layer, target: Layer, found: zo.MatchResult | Correspondence) -> list[Attribute]:
    """Transfer all attributes of the source to the target: components, then custom attributes."""
    attributes = [*source.components.values(), *source.custom]
    received = []
    for number, attribute in enumerate(attributes):
        with stage(f"Transferring {attribute.name}", number / len(attributes), (number + 1) / len(attributes)):
            received.append(transfer(attribute, found, source.surface, target.surface))
    return received


def _normals(layer: Layer) -> Attribute:
    """The vertex normals of a layer in the global frame."""
    return Attribute(NORMAL, Domain.POINT, Kind.NORMAL, turn_normals(layer.normals, layer.transform))


def _selections(layer: Layer) -> dict[str, Attribute]:
    """The selections of vertices and faces of a layer in which nothing is selected."""
    counts = {
        "vertex_selection": (Domain.POINT, len(layer.vertices)),
        "face_selection": (Domain.FACE, len(layer.faces)),
    }
    return {
        name: Attribute(name, domain, Kind.BOOLEAN, np.zeros(count, dtype=bool))
        for name, (domain, count) in counts.items()
        if count
    }


def _merge(target: Layer, source: Layer, received: list[Attribute]) -> Layer:
    """The target with its new attributes."""
    count = len(source.components)
    components = {attribute.name: attribute for attribute in received[:count]}
    normal = components.pop(NORMAL, None)
    custom = {(a.name, a.domain, a.kind): a for a in (*target.custom, *received[count:])}
    return replace(
        target,
        label=f"{target.label}_transferred",
        normals=target.normals if normal is None else normal.values @ target.transform[:3, :3],
        components=target.components | components,
        custom=tuple(custom.values()),
        textures=source.textures if TEXCOORD in components else target.textures,
    )


def _notes(target: Layer, new: Layer) -> list[str]:
    """Notes on the new layer that do not follow from the correspondence."""
    if new.textures is None:
        return []
    notes = []
    if target.faux.any():
        notes.append("Polygons became triangles: MeshLab cannot save texture coordinates of polygons.")
    unread = new.textures.names.count(DUMMY)
    if unread:
        notes.append(
            warning(
                "MeshLab could not read {count} of the texture images and shows a checkerboard: put PNG images next to "
                "the mesh, because its wheels may not support JPEG.",
                count=unread,
            )
        )
    absent = [name for name in new.textures.names if name not in new.textures.images]
    if absent:
        notes.append(
            warning(
                "The MeshSet has no image for {names}: load the mesh from its file, because pymeshlab does not copy "
                "images between MeshSets.",
                names=" and ".join(absent),
            )
        )
    return notes
