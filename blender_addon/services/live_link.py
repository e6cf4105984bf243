# SPDX-License-Identifier: GPL-3.0-or-later
"""Keep a target linked to its source: a modifier lets its layers follow edits of the source's, and the rest is updated.

A transfer writes everything first. Layers whose values are mixtures of the source's then follow through Geometry Nodes;
shape keys, materials, marks, normals and all other chosen data follow at the next update.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial

import numpy as np
from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.assets.asset import to_srgb
from zoomout_core.messages import message, plural
from zoomout_core.runtime.progress import portion, stage
from zoomout_core.transfer import Attribute, Domain, Kind, map_target
from zoomout_core.transfer.live_link import are_mixed, pick, pick_points
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.picks import Picks

from .. import mesh_data
from ..adapters import DEFAULT, USUAL_DATA, Settings
from ..jobs import compute, run
from ..mesh_data import Layer, LinkedLayer, ObjectPair
from ..scene.pair import evaluated_sources, find_mesh, name_of, writing
from ..scene.stored_pair import read_stored_match
from ..storage import stored_link, stored_match
from .targets import Write
from .transfer import prepare_transfer

# Fraction of the progress for the transfer.
TRANSFERRING = 0.7
# Colours of eight bits are rounded by up to half a step, in sRGB, and by Blender's own conversion.
HALF_BYTE_STEP = 0.55 / 255
# Smaller weights than this are dropped by a transfer; differences below do not move a vertex visibly.
SAME_WEIGHT = 1e-5


def keep_linked(
    context: Context,
    target: Object,
    data: Collection[str] = USUAL_DATA,
    settings: Settings = DEFAULT,
) -> dict[str, float]:
    """Transfer data along the match stored on a target, and let the target follow edits of the source.

    UV maps, colours, numbers, vectors, labels and vertex groups follow at once, by a modifier; other data follows with
    `update_linked`.

    Args:
        context: Blender's; the target is in its scene.
        target: the object that follows the source that it was matched with.
        data: the kinds of data, of `DATA`.
        settings: how to transfer it; values must replace the target's.

    Returns:
        The share of elements that follow, by the names of the linked layers and vertex groups. Others were filled in,
        or adjusted to limits, and follow with `update_linked`.

    Raises:
        MeshError: the target was not matched, or cannot be linked; nothing was written.
    """
    return run(prepare_link(context, name_of(target), data, settings))()


def update_linked(context: Context, target: Object) -> dict[str, float]:
    """Transfer everything to a linked target again, and renew the link; returns what `keep_linked` does.

    Raises:
        MeshError: the target is not linked, or its match is no longer valid; nothing was written.
    """
    return run(prepare_update(context, name_of(target)))()


async def prepare_update(context: Context, target_name: str) -> Write[dict[str, float]]:
    """`update_linked` without writing: returns a function that writes."""
    linked = stored_link.link_of(find_mesh(context, target_name))
    if linked is None:
        raise zo.MeshError("'{target}' is not linked: use Keep Linked first.", target=target_name)
    try:
        settings = Settings(**linked["settings"])
    except TypeError as error:
        raise zo.MeshError(
            "The link of '{target}' was made by another version: use Keep Linked again.", target=target_name
        ) from error
    return await prepare_link(context, target_name, linked["data"], settings)


async def prepare_link(
    context: Context, target_name: str, data: Collection[str], settings: Settings
) -> Write[dict[str, float]]:
    """`keep_linked` without writing: returns a function that writes."""
    pair, match = await read_stored_match(context, target_name)
    _check(context, pair, settings)
    with portion(0, TRANSFERRING):
        write_transfer = await prepare_transfer(context, pair.source_name, target_name, data, settings)
    layers, weights, of_source = _read(context, pair, settings)
    with portion(TRANSFERRING, 1), stage("Linking"):
        mapped = map_target(match, pair.source, pair.target, settings.fill_below)
        attributes = [layer.attribute for layer in layers]
        picks = await compute(partial(_pick_all, attributes, mapped))

    def write() -> dict[str, float]:
        with writing(context, pair) as (source, target):
            written = write_transfer()["written"]
            linked = [
                _link_layer(target, layer, of_layer, mapped, settings)
                for layer, of_layer in zip(layers, picks, strict=True)
                if of_layer is not None and layer.attribute.name in written[layer.role.value]
            ]
            if of_source.keys() >= set(written["vertex_groups"]):
                linked += _link_groups(
                    target, weights, of_source, pick_points(weights, mapped), written["vertex_groups"]
                )
            shares = {layer.name: float(layer.linked.mean()) for layer in linked}
            _store(target, pair, data, settings, shares)
            mesh_data.write_link(target, source, pair.source, [layer for layer in linked if layer.linked.any()])
        return shares

    return write


def summary(target: str, shares: dict[str, float]) -> str:
    """A link in one sentence."""
    return message(
        "'{target}' follows its source: {layers} at once, other data with Update Linked",
        target=target,
        layers=plural(sum(share > 0 for share in shares.values()), "{count} layer", "{count} layers"),
    )


def _check(context: Context, pair: ObjectPair, settings: Settings) -> None:
    if len(pair.sources) > 1:
        raise zo.MeshError(
            "'{target}' was matched with several objects, but can be linked to only one: match it with one source.",
            target=pair.target_name,
        )
    if pair.source_fingerprints[0].at_base:
        raise zo.MeshError(
            "Modifiers that change the faces of '{source}' were added after the match: match again.",
            source=pair.source_name,
        )
    if not settings.blend(find_mesh(context, pair.target_name)).replaces:
        raise zo.MeshError(
            "A link replaces the target's values: set Where to Everywhere and Factor to 1, and remove the Mask."
        )


def _read(context: Context, pair: ObjectPair, settings: Settings) -> tuple[list[Layer], Attribute, dict[str, str]]:
    """The source's layers that nodes can mix, its weights, and the names of groups on it by those on the target.

    Groups that get the same name on the target are left out, because a link cannot add them up.
    """
    with evaluated_sources(context, pair) as (source,):
        found, _ = mesh_data.read_layers(source.mesh, settings.turning)
        weights = mesh_data.read_weights(source.evaluated, source.mesh)
        names = {*weights.labels, *mesh_data.deforming_bones(source.original)}
    layers = [
        layer
        for layer in found
        if layer.data_type in mesh_data.NODE_TYPES
        and not layer.turning
        and not layer.attribute.name.startswith(".")  # internal, such as sculpt masks
    ]
    new = {label: settings.new_name(label, names) for label in weights.labels}
    count = Counter(new.values())
    return layers, weights, {name: label for label, name in new.items() if count[name] == 1}


def _pick_all(attributes: Sequence[Attribute], mapped: MappedTarget) -> list[Picks | None]:
    return [pick(attribute, mapped) for attribute in attributes]


def _link_layer(target: Object, layer: Layer, picks: Picks, mapped: MappedTarget, settings: Settings) -> LinkedLayer:
    """A layer of the target, which follows where the written values are mixtures of the source's."""
    name, domain = layer.attribute.name, layer.attribute.domain
    written = mesh_data.read_layer(target.data, name, layer.role).attribute
    if layer.data_type == "BYTE_COLOR":
        linked = are_mixed(picks, layer.attribute, written, HALF_BYTE_STEP, to_srgb)
    else:
        linked = are_mixed(picks, layer.attribute, written)
    if mapped.has_partner is not None and settings.without_partner == "keep":
        linked &= _elements_of_vertices(mapped, domain)
    return LinkedLayer(name, name, domain, layer.data_type, picks, linked)


def _elements_of_vertices(mapped: MappedTarget, domain: Domain) -> np.ndarray:
    """(q,) the elements of the target of a domain all of whose vertices have a partner."""
    target, has_partner = mapped.target, np.asarray(mapped.has_partner)
    if domain is Domain.POINT:
        return has_partner
    of_corner = has_partner[target.corner_vertex]
    return of_corner if domain is Domain.CORNER else np.logical_and.reduceat(of_corner, target.face_start[:-1])


def _link_groups(
    target: Object, weights: Attribute, of_source: Mapping[str, str], picks: Picks, written: Sequence[str]
) -> list[LinkedLayer]:
    """The vertex groups that were written, which follow at vertices where all of them are mixtures of the source's.

    A transfer keeps few groups of a vertex, and scales them to their sum: where that changes them, none follows.

    Args:
        target: the object that the groups were written to.
        weights: the source's.
        of_source: the names of groups on the source by those on the target.
        picks: the vertices of the source that the target's read.
        written: the names of the groups on the target.
    """
    own = mesh_data.read_weights(target, target.data)
    linked = np.ones(len(target.data.vertices), dtype=bool)
    for name in written:
        there, here = (
            replace(found, values=found.values[:, [found.labels.index(label)]].toarray()[:, 0], kind=Kind.SCALAR)
            for found, label in ((weights, of_source[name]), (own, name))
        )
        linked &= are_mixed(picks, there, here, SAME_WEIGHT)
    return [LinkedLayer(name, of_source[name], Domain.POINT, "FLOAT", picks, linked) for name in written]


def _store(
    target: Object, pair: ObjectPair, data: Collection[str], settings: Settings, shares: Mapping[str, float]
) -> None:
    """Store how a target was linked."""
    match = stored_match.description(target.data)
    chosen = asdict(settings) | {"turning": list(settings.turning)}
    entries = "" if match is None else match.get("entries") or ""
    stored_link.write(target.data, pair.source_name, sorted(data), chosen, shares, entries)
