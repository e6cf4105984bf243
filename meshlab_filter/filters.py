"""Filters for pymeshlab's MeshSet, called as functions: `transfer_attributes(ms, sourcemesh=0, targetmesh=1)`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import zoomout_core as zo
from meshlab_filter.mesh_data import TEXCOORD, Layer, add_layer, check_target, read_layer
from zoomout_core.progress import Progress, Steps, drain, within
from zoomout_core.transfer import Attribute, transfer

if TYPE_CHECKING:
    from pymeshlab import MeshSet

# What MeshLab calls the image that it shows in place of one that it cannot read.
DUMMY = "dummy.png"


def transfer_attributes(
    ms: MeshSet,
    sourcemesh: int = 0,
    targetmesh: int = 1,
    *,
    texcoordtransfer: bool = True,
    colortransfer: bool = True,
    qualitytransfer: bool = True,
    selectiontransfer: bool = False,
    customattributes: Sequence[str] = (),
    candidate: int = 0,
    **matching: Any,
) -> dict[str, Any]:
    """Transfer attributes between meshes that correspond, whatever their poses and their triangles.

    The result is a new layer, and the current one: a copy of the target on which what the source has takes
    the place of what the target had. Source and target stay as they are, and on an error there is no new
    layer. Where the source has texture coordinates, polygons of the target become triangles in the new layer,
    since MeshLab cannot save the coordinates of polygons; custom attributes of the target are not in it.

    Args:
        ms: a `pymeshlab.MeshSet`.
        sourcemesh: id of the mesh that has the attributes.
        targetmesh: id of the mesh that receives them.
        texcoordtransfer: texture coordinates of wedges, or else of vertices, and their textures.
        colortransfer: colours of vertices and faces.
        qualitytransfer: scalars ("quality") of vertices and faces.
        selectiontransfer: selections of vertices and faces.
        customattributes: names of custom scalar and point attributes, which pymeshlab cannot list.
        candidate: which of the correspondences found to use; try another where sides are swapped.
        matching: `initial`, `landmarks`, `initial_map`, `common_axes` and whatever else `zoomout_core.match` takes.

    Returns:
        `mesh_id` of the new layer; `transferred`, names; `confidence`, an array that says for each vertex
        how far to trust it, in [0, 1]; `candidates`, for each what it came from, whether it reverses
        orientation, and its scores; `notes`, sentences for the user.

    Raises:
        MeshError: a mesh that is missing or cannot be used; the message says what to do.
        ValueError: arguments that do not fit together.
    """
    return drain(
        transfer_attributes_steps(
            ms,
            sourcemesh,
            targetmesh,
            texcoordtransfer=texcoordtransfer,
            colortransfer=colortransfer,
            qualitytransfer=qualitytransfer,
            selectiontransfer=selectiontransfer,
            customattributes=customattributes,
            candidate=candidate,
            **matching,
        )
    )


def transfer_attributes_steps(
    ms: MeshSet,
    sourcemesh: int = 0,
    targetmesh: int = 1,
    *,
    texcoordtransfer: bool = True,
    colortransfer: bool = True,
    qualitytransfer: bool = True,
    selectiontransfer: bool = False,
    customattributes: Sequence[str] = (),
    candidate: int = 0,
    **matching: Any,
) -> Steps[dict[str, Any]]:
    """`transfer_attributes` as a generator that yields `Progress` and returns the dictionary."""
    wanted = {
        TEXCOORD: texcoordtransfer,
        "vertex_color": colortransfer,
        "face_color": colortransfer,
        "vertex_scalar": qualitytransfer,
        "face_scalar": qualitytransfer,
        "vertex_selection": selectiontransfer,
        "face_selection": selectiontransfer,
    }
    source, target = read_layer(ms, sourcemesh, customattributes), read_layer(ms, targetmesh)
    source = replace(source, components={name: a for name, a in source.components.items() if wanted[name]})
    if not source.components and not source.custom:
        raise zo.MeshError(
            f"Layer '{source.label}' has none of the attributes to transfer: "
            "check which mesh is the source, or ask for others."
        )
    check_target(target)

    matched = zo.match_steps(source.surface, target.surface, **matching)
    result = yield from within(matched, 0.0, 0.7)
    if candidate:
        result = yield from within(result.use_steps(candidate), 0.7, 0.8)
    received = yield from within(_transfer_steps(source, target, result), 0.8, 1.0)
    new = _merged(target, source, received)
    return {
        "mesh_id": add_layer(ms, new),
        "transferred": [attribute.name for attribute in received],
        "confidence": result.confidence,
        "candidates": [
            {"origin": found.origin, "reverses_orientation": found.reverses_orientation, **found.scores}
            for found in result.candidates
        ],
        "notes": [*result.notes, *(note for attribute in received for note in attribute.notes), *_notes(target, new)],
    }


def _transfer_steps(source: Layer, target: Layer, result: zo.MatchResult) -> Steps[list[Attribute]]:
    """All attributes of the source on the target: components, then custom attributes."""
    attributes = [*source.components.values(), *source.custom]
    received = []
    for number, attribute in enumerate(attributes):
        yield Progress(number / len(attributes), f"Transferring {attribute.name}")
        received.append(transfer(attribute, result, source.surface, target.surface))
    return received


def _merged(target: Layer, source: Layer, received: list[Attribute]) -> Layer:
    """The target with what it received."""
    count = len(source.components)
    components = {attribute.name: attribute for attribute in received[:count]}
    return replace(
        target,
        label=f"{target.label}_transferred",
        components=target.components | components,
        custom=tuple(received[count:]),
        textures=source.textures if TEXCOORD in components else target.textures,
    )


def _notes(target: Layer, new: Layer) -> list[str]:
    """What happened to the new layer that does not follow from the correspondence."""
    if new.textures is None:
        return []
    notes = []
    if target.faux.any():
        notes.append("Polygons became triangles: MeshLab cannot save texture coordinates of polygons.")
    unread = new.textures.names.count(DUMMY)
    if unread:
        notes.append(
            f"MeshLab could not read {unread} of the texture images and shows a checkerboard: "
            "put them beside the mesh, as PNG, for its wheels may lack JPEG."
        )
    absent = [name for name in new.textures.names if name not in new.textures.images]
    if absent:
        notes.append(
            f"The MeshSet has no image of {' and '.join(absent)}: load the mesh from its file, "
            "for pymeshlab does not copy images from one MeshSet to another."
        )
    return notes
