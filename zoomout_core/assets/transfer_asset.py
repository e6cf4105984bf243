# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfer attributes, materials and skin of an asset to another mesh, and take it to the rest pose."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from zoomout_core.assets.add_joints import add_joints
from zoomout_core.assets.asset import COLOR, MATERIALS, NORMALS, SHAPE_KEYS, UV, WEIGHTS, Asset, Skin, kind_of
from zoomout_core.assets.bind_asset import Binding, bind_to_joints, skin_weights
from zoomout_core.assets.keep_rest import keep_rest
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.messages import enumeration, message, plural
from zoomout_core.runtime.option_names import suggest_names
from zoomout_core.runtime.progress import advance, portion, stage
from zoomout_core.runtime.threads import on_one_blas_thread
from zoomout_core.transfer.attribute import Attribute
from zoomout_core.transfer.blend import mask_of
from zoomout_core.transfer.blend_settings import Blend
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.rigging.motion import MotionCheck
from zoomout_core.transfer.rigging.rest_pose import PosedTarget, correct_by_bones, correct_map, find_pose, is_in_place
from zoomout_core.transfer.rules import Match, map_target, transfer_along

# Kinds of data that can be transferred, in this order.
KINDS = (UV, COLOR, MATERIALS, SHAPE_KEYS, WEIGHTS, NORMALS)
# Whether to unpose a target that gets a skin: if its pose differs from the source's rest pose, always, or never.
SHAPES = ("automatic", "rest pose", "keep shape")
# Fractions of the progress at which the pose is found, and attributes are transferred.
FOUND, TRANSFERRED = 0.2, 0.7


@runtime_checkable
class MatchWithLandmarks(Protocol):
    """A match that may have exact landmarks, to which it bends corrected maps."""

    def meet_landmarks(self, surface_map: SurfaceMap) -> SurfaceMap: ...


class ReportedVerdict(Protocol):
    """A verdict on a match."""

    @property
    def is_wrong(self) -> bool: ...


@runtime_checkable
class MatchWithVerdict(Protocol):
    """A match with a verdict; bones correct its map unless it is probably wrong."""

    @property
    def verdict(self) -> ReportedVerdict | None: ...


class TransferredAsset(NamedTuple):
    """A target with the received data.

    Attributes:
        asset: the target.
        received: names of received attributes.
        notes: sentences for the user.
        motions: how each animation differs from the source's, if joints were moved.
        mapped: the target over the source, with a map that its bones may have corrected; None if nothing was mapped.
    """

    asset: Asset
    received: tuple[str, ...]
    notes: tuple[str, ...]
    motions: tuple[MotionCheck, ...] = ()
    mapped: MappedTarget | None = None


@suggest_names
@memory_in_words
@on_one_blas_thread
def transfer_asset(
    source: Asset,
    target: Asset,
    match: Match,
    kinds: Collection[str] = KINDS[:-1],
    shape: str = "automatic",
    fill_below: float | None = None,
    max_weights: int | None = None,
    move_rig: bool = False,
    mask: ArrayLike | None = None,
) -> TransferredAsset:
    """Transfer the data of an asset to another mesh; it replaces the target's data of the same kind.

    Shape keys replace those of the same name only.

    A skin brings its joints and their animations: the target is taken to the rest pose, and then moves like the source.

    Args:
        source: the asset with the attributes.
        target: the asset that receives them.
        match: the match of the two surfaces.
        kinds: the kinds to transfer, from `KINDS`.
        shape: how to take the target to the rest pose, from `SHAPES`.
        fill_below: confidence below which values are filled in from around, see `transfer.transfer`.
        max_weights: maximum number of joints of a vertex; that of the source by default.
        move_rig: move the joints into the target, which keeps its size, and compare how both play the animations.
            Otherwise the joints stay where they are, and the target takes the size of the source. With a mask, add the
            joints that move the part to those of the target, and give the part their weights.
        mask: (n_t,) share of the source's data at each vertex of the target, in [0, 1]. The target keeps the rest of
            its data, its joints and, unless `move_rig` is set, its weights, so that several sources may share it. None
            to receive all.

    Raises:
        MeshError: the source has no data of these kinds, it has no skin to move, a joint to move is scaled to nothing,
            or the map is of other surfaces.
        ValueError: the shape is not in `SHAPES`, a kind not in `KINDS`, or the mask does not fit the target.

    Example:
        >>> color = zo.Attribute("color", zo.Domain.POINT, zo.Kind.COLOR, np.ones((len(source.vertices), 4)))
        >>> made = zo.transfer_asset(zo.Asset(source, (color,)), zo.Asset(target), result, kinds=["color"])
        >>> [attribute.name for attribute in made.asset.attributes]
        ['color']
    """
    _check_choices(kinds, shape)
    part = None
    if mask is not None:
        part = Blend(mask=mask_of(mask, target.surface))
        kinds = kinds if move_rig else without_weights(kinds)
    chosen, skin = select_data(source, kinds)
    if move_rig and skin is None:
        raise MeshError("The source has no joints to move: choose a rigged source, and transfer its skin weights.")
    if move_rig:
        _check_joints((source,) if part is None else (source, target))
    mapped = map_target(match, source.surface, target.surface, fill_below)
    replaced = {kind_of(each) for each in chosen}
    posed, corrected = None, mapped
    if source.skin is not None:
        with stage("Finding the pose", 0, FOUND):
            posed, corrected = _find_pose(
                mapped, source, source.skin, skin is not None and part is None, not _is_wrong(match)
            )
            corrected = _meet_landmarks(corrected, mapped, match)
    with portion(0.0 if source.skin is None else FOUND, TRANSFERRED):
        attributes, notes = _transfer_attributes(chosen, replaced, target, corrected)
    asset = replace(target, attributes=attributes, notes=(), stored_map=None)
    if MATERIALS in replaced:
        asset = replace(asset, materials=source.materials, look=source.look)
    names = tuple(each.name for each in chosen)
    if part is None:
        notes += _note_on_replaced(target, replaced, skin is not None)
    else:
        asset, of_rest = keep_rest(target, asset, list(names), part)
        notes += of_rest
    motions: tuple[MotionCheck, ...] = ()
    if skin is not None and part is not None:
        with stage("Adding joints", TRANSFERRED, 1.0):
            own_weights = skin_weights(skin, mapped, max_weights)
            asset, of_joints = add_joints(source, asset, mapped, own_weights, mask_of(part.mask, target.surface))
            notes += of_joints
    elif skin is not None:
        with stage("Binding to the joints", TRANSFERRED, 1.0):
            binding = Binding(shape, max_weights, move_rig)
            asset, motions, of_binding = bind_to_joints(asset, source, skin, mapped, posed, binding)
            notes += of_binding
    advance(1.0)
    return TransferredAsset(asset, names, tuple(notes), motions, corrected)


def _check_choices(kinds: Collection[str], shape: str) -> None:
    """Check the arguments of `transfer_asset` that are chosen from lists."""
    if shape not in SHAPES:
        raise ValueError(f"shape is {shape!r}: give {', '.join(SHAPES)}.")
    if isinstance(kinds, str) or not isinstance(kinds, Collection):
        raise TypeError(f"kinds is {kinds!r}: give a list of {', '.join(KINDS)}.")
    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown:
        raise ValueError(f"Unknown kind {unknown[0]!r}: choose from {', '.join(KINDS)}.")


def _check_joints(assets: Sequence[Asset]) -> None:
    """Check that all joints have a place; the inverse of a frame that is scaled to nothing has none."""
    for skin in (each.skin for each in assets if each.skin is not None):
        flat = np.flatnonzero(np.linalg.matrix_rank(skin.inverse_bind) < 4)
        if len(flat):
            raise MeshError(
                f"The joint {skin.names[flat[0]]} is scaled to nothing in its rest pose, so it cannot be moved: give "
                "it a size in the program that wrote the file."
            )


def _find_pose(
    mapped: MappedTarget, source: Asset, skin: Skin, binds: bool, corrects: bool
) -> tuple[PosedTarget | None, MappedTarget]:
    """The pose of a target if it is bound and not in place, and the target with the map, which the bones may correct.

    Args:
        mapped: the target over the source.
        source: the asset with the joints.
        skin: its skin.
        binds: whether the target is bound to the joints.
        corrects: whether the bones correct the map.
    """
    rigged = source.surface.with_vertices(skin.rest), skin.weights, skin.parents
    if not binds:
        return None, correct_by_bones(mapped, *rigged) if corrects else mapped
    if is_in_place(source.surface, mapped.target):
        return None, mapped
    posed = find_pose(mapped, *rigged)
    return posed, correct_map(mapped, posed, skin.weights) if corrects else mapped


def _is_wrong(match: Match) -> bool:
    """Whether a match has a verdict, by which it is probably wrong."""
    return isinstance(match, MatchWithVerdict) and match.verdict is not None and match.verdict.is_wrong


def _meet_landmarks(corrected: MappedTarget, mapped: MappedTarget, match: Match) -> MappedTarget:
    """A target whose corrected map is bent to the exact landmarks of its match, if it has any."""
    if corrected is mapped or not isinstance(match, MatchWithLandmarks):
        return corrected
    return replace(corrected, surface_map=match.meet_landmarks(corrected.surface_map))


def _transfer_attributes(
    chosen: Sequence[Attribute], kinds: Collection[str], target: Asset, mapped: MappedTarget
) -> tuple[tuple[Attribute, ...], list[str]]:
    """The target's attributes, those of some kinds replaced by the chosen ones, and notes."""
    received = {each.name: each for each in target.attributes if kind_of(each) not in kinds}
    notes: list[str] = []
    for number, attribute in enumerate(chosen):
        start, end = ((number + step) / len(chosen) for step in (0, 1))
        with stage(message("Transferring {what}", what=attribute.name), start, end):
            transferred = transfer_along(attribute, mapped)
            if attribute.name == SHAPE_KEYS:
                transferred = _add_keys(target.find(SHAPE_KEYS), transferred)
        received[attribute.name] = transferred
        notes += transferred.notes
    return tuple(received.values()), notes


def select_data(source: Asset, kinds: Collection[str]) -> tuple[list[Attribute], Skin | None]:
    """Select the attributes and the skin of an asset by kind.

    Raises:
        MeshError: there are none.
        ValueError: there are no kinds.
    """
    if not kinds:
        raise ValueError("kinds is empty: name the data to transfer.")
    chosen = [each for each in source.attributes if kind_of(each) in kinds]
    skin = source.skin if WEIGHTS in kinds else None
    if not chosen and skin is None:
        raise MeshError(
            f"The source has no {' or '.join(kinds)}: check which file is the source, or choose other data."
        )
    return chosen, skin


def without_weights(kinds: Collection[str]) -> list[str]:
    """The kinds that a part of a target can receive.

    Raises:
        MeshError: there are none.
    """
    chosen = [kind for kind in kinds if kind != WEIGHTS]
    if not chosen:
        raise MeshError(
            "A part of a target keeps its joints and their weights: choose other data for it, or move the rig."
        )
    return chosen


def _add_keys(own: Attribute | None, transferred: Attribute) -> Attribute:
    """Shape keys that a target has, followed by those that it receives, which replace any of the same name."""
    if own is None:
        return transferred
    labels = tuple(dict.fromkeys((*own.labels, *transferred.labels)))
    values = np.zeros((len(own.values), len(labels), 3))
    for each in (own, transferred):
        values[:, [labels.index(label) for label in each.labels]] = each.values
    return replace(transferred, values=values, labels=labels)


def base_of(source: Asset, target: Asset, kinds: Collection[str]) -> Asset:
    """The asset whose nodes and joints the result of a transfer has: that with the skin."""
    return source if WEIGHTS in kinds and source.skin is not None else target


def _note_on_replaced(target: Asset, kinds: Collection[str], with_joints: bool) -> list[str]:
    """A note on the target's own materials, joints and animations, if others take their place."""
    counts = []
    if MATERIALS in kinds:
        counts.append(plural(len(target.materials), "1 material", "{count} materials"))
    if with_joints:
        joints = 0 if target.skin is None else len(target.skin.names)
        animations = 0 if target.document is None else len(target.document.gltf.animations)
        counts += [
            plural(joints, "1 joint", "{count} joints"),
            plural(animations, "1 animation", "{count} animations"),
        ]
    own = [each for each in counts if each.values["count"]]
    return [message("The target's own {things} were replaced.", things=enumeration(own))] if own else []
