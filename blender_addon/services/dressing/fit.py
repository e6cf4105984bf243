# SPDX-License-Identifier: GPL-3.0-or-later
"""Fit objects that a source wears to a target: shapes, bones, weights and keys, as arrays without Blender."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csr_array, diags_array

import zoomout_core as zo
from zoomout_core.arrays import Booleans, Floats
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.messages import Message, enumeration, message, plural_warning
from zoomout_core.runtime.progress import portion
from zoomout_core.transfer import (
    Dressed,
    JointPairs,
    Manner,
    Skeleton,
    WeightedBody,
    align_joints,
    fit_to_shape,
    moving_with_skin,
    pair_bones,
    shape_of_source,
)
from zoomout_core.transfer.dressing.hidden_skin import keys_that_hide_skin
from zoomout_core.transfer.dressing.missing_skin import place_by_bones, without_missing_limbs
from zoomout_core.transfer.rigging.joint_map import RiggedBody
from zoomout_core.transfer.rigging.skinning import strongest

from ...mesh_data import BodyKeys, Bones, OutfitBones, Worn
from ...storage import stored_match
from .read import Dressing, Fitting, Rigs
from .worn_weights import BodyPair, BoneNames, Change, GroupWeights, clear_copies, follow_groups, weights_of_bones

# Fractions of the progress for giving the source the target's shape, and for fitting, before objects follow keys.
SHAPING, FITTED = 0.8, 0.9


@dataclass(frozen=True, eq=False)
class Fit:
    """The fitted objects.

    Attributes:
        dressed: their shapes.
        moved: (4, 4) the motion of the body, as a similarity.
        keys: (n, keys, 3) offsets of each object that follow the target's keys; zero for those without shape keys.
        outfit: the outfit's own bones in their new places, if they are to be copied.
        pairs: names of the target's bones by those of the source's.
        weights: how the weights of each copy change; None where they stay.
        hiding: names of the source's active shape keys that hide skin below the objects.
    """

    dressed: Dressed
    moved: Floats
    keys: list[Floats]
    outfit: OutfitBones | None = None
    pairs: dict[str, str] = field(default_factory=dict)
    weights: list[Change | None] = field(default_factory=list)
    hiding: tuple[str, ...] = ()


def rigged_bodies(fitting: Fitting) -> tuple[RiggedBody | None, RiggedBody | None]:
    """The source without worn parts, and the target, with their bones; None unless they have different armatures."""
    if fitting.rigs is None or fitting.weights is None:
        return None, None
    rigs, weights = fitting.rigs, fitting.weights
    of_source, of_target = (
        weights_of_bones(groups, bones.names)
        for groups, bones in ((weights.source, rigs.body), (weights.target, rigs.others))
    )
    of_body = csr_array(diags_array(fitting.is_body.astype(np.float64)) @ of_source)
    return (
        RiggedBody(fitting.source, _skeleton(rigs.body), of_body),
        RiggedBody(fitting.target, _skeleton(rigs.others), of_target),
    )


def _skeleton(bones: Bones) -> Skeleton:
    return Skeleton(bones.names, bones.parents, bones.heads)


def fit_worn(match: stored_match.Match | zo.SurfaceMap, fitting: Fitting, dressing: Dressing) -> Fit:
    """Fit the worn objects, and let them follow the target's keys."""
    with portion(0, SHAPING):
        shape = shape_of_source(match, fitting.source, fitting.target)
    body, is_body = body_without_worn(fitting)
    shape = shape[is_body]
    manners = [_manner(each, dressing.manner) for each in fitting.worn]
    with portion(SHAPING, FITTED):
        if fitting.rigs is not None and fitting.weights is not None:
            shape = _align(BodyPair(body, is_body, shape, fitting.target), fitting.rigs, fitting.weights)
        placed = shape
        if fitting.clothed is not None:
            _, target = rigged_bodies(fitting)
            by_bones = None if target is None else place_by_bones(fitting.clothed, shape, target)
            if by_bones is not None:
                placed, shape = by_bones
        dressed = fit_to_shape(
            body,
            placed,
            fitting.target,
            [each.shape for each in fitting.worn],
            manners=manners,
            keep=[each.mask for each in fitting.worn],
            stiffness=dressing.stiffness,
            gap=dressing.gap,
        )
    motion, moved = procrustes(body.vertices, shape), np.eye(4)
    moved[:3, :3], moved[:3, 3] = motion.linear, motion.translation
    fit = Fit(dressed, moved, [], hiding=tuple(dict.fromkeys(_hiding_keys(fitting))))
    if fitting.rigs is not None and fitting.weights is not None:
        fit = _move_bones(fit, fitting, fitting.rigs, body, shape)
        bodies = BodyPair(body, is_body, shape, fitting.target)
        fit = _follow_weights(fit, fitting, fitting.rigs, fitting.weights, bodies)
        dressed = clear_copies(
            fit.dressed, fit.weights, fitting.weights, fitting.rigs.others, fitting.rigs.outfit, fit.pairs
        )
        fit = replace(fit, dressed=dressed)
    if fitting.keys is None:
        return fit
    dressed = fit.dressed
    with portion(FITTED, 1):
        keys = _follow_keys(fitting, fitting.keys, fit)
    if not fitting.worn[0].at_rest:  # then the target's keys have their present values
        still = [np.einsum("nkx,k->nx", each, fitting.keys.values) for each in keys]
        vertices = tuple(points - off for points, off in zip(dressed.vertices, still, strict=True))
        dressed = replace(dressed, vertices=vertices)
    return replace(fit, dressed=dressed, keys=keys)


def _manner(worn: Worn, chosen: Manner) -> Manner:
    """How to fit an object, given the chosen manner."""
    if chosen != "automatic":
        return chosen
    if worn.hangs_from_bone:
        return "rigid"
    return "hair" if worn.is_hair else "automatic"


def _align(bodies: BodyPair, rigs: Rigs, weights: GroupWeights) -> Floats:
    """The shape of a body, aligned with the joints of the target's armature."""
    of_body = weights_of_bones(weights.source, rigs.body.names)[bodies.is_body]
    pairs = JointPairs.of(_skeleton(rigs.body), csr_array(of_body), _skeleton(rigs.others))
    return align_joints(bodies.body, bodies.shape, bodies.target, pairs)


def _move_bones(fit: Fit, fitting: Fitting, rigs: Rigs, body: zo.Surface, shape: Floats) -> Fit:
    """Move the outfit's own bones along with the objects, and find the partners of all others."""
    outfit = rigs.outfit
    ends, upright = outfit.ends.copy(), outfit.upright.copy()
    for number, worn in enumerate(fitting.worn):
        own = np.flatnonzero([name == worn.name for name in outfit.wearer])
        joints = zo.move_joints(worn.shape, fit.dressed.vertices[number], outfit.ends[own].reshape(-1, 3))
        ends[own] = joints.positions.reshape(-1, 2, 3)
        upright[own] = np.einsum("bxy,by->bx", joints.rotations[::2], outfit.upright[own])
    size = float(np.ptp(fitting.target.vertices, axis=0).max())
    heads = zo.move_joints(body, shape, rigs.body.heads).positions
    pairs = pair_bones(_skeleton(rigs.body)._replace(heads=heads), _skeleton(rigs.others), size)
    return replace(fit, outfit=replace(outfit, ends=ends, upright=upright), pairs=pairs)


def _follow_weights(fit: Fit, fitting: Fitting, rigs: Rigs, weights: GroupWeights, bodies: BodyPair) -> Fit:
    """Change the weights of the copies as those of the body below them change."""
    partners = {name: fit.pairs.get(name, name) for name in rigs.body.names}
    names = BoneNames(partners, rigs.outfit.names, rigs.others.names)
    bodies = _without_missing_limbs(bodies, fitting, names)
    changes = follow_groups(weights, names, bodies, fitting.worn, fit.dressed.vertices)
    return replace(fit, weights=changes)


def _without_missing_limbs(bodies: BodyPair, fitting: Fitting, names: BoneNames) -> BodyPair:
    """A pair without the cloth of limbs on which the target has no skin."""
    clothed, weights = fitting.clothed, fitting.weights
    if clothed is None or weights is None:
        return bodies
    of_target = csr_array(weights_of_bones(weights.target, names.target))
    present = {names.target[bone] for bone in np.unique(strongest(of_target))}
    has_skin = np.array([names.partners.get(name, name) in present for name in clothed.body.bones.names])
    kept = without_missing_limbs(clothed, has_skin)
    return BodyPair(bodies.body.subset(kept), kept, bodies.shape[kept], bodies.target)


def _follow_keys(fitting: Fitting, keys: BodyKeys, fit: Fit) -> list[Floats]:
    """(n, keys, 3) offsets of each fitted object that follow the target's keys, zero without shape keys.

    Correctives act while bones rotate. They do not move cloth that stays in place while the skin leaves it.
    """
    dressed = fit.dressed
    offsets = [np.zeros((len(points), len(keys.keys), 3)) for points in dressed.vertices]
    taking = [number for number, worn in enumerate(fitting.worn) if worn.takes_keys]
    shapes = [_in_shape(fitting.worn[number].shape, dressed.vertices[number]) for number in taking]
    masks = [fitting.worn[number].mask for number in taking]
    followed = zo.follow_keys(fitting.target, keys.offsets, shapes, keep=masks)
    along = _moving_with_skin(fitting, fit, taking, shapes) if keys.is_corrective.any() else [None] * len(taking)
    for number, found, degree in zip(taking, followed, along, strict=True):
        if degree is not None:
            found[:, keys.is_corrective] *= degree[:, None, None]
        offsets[number] = found
    return offsets


def _moving_with_skin(
    fitting: Fitting, fit: Fit, numbers: Sequence[int], shapes: Sequence[zo.Surface | zo.Lines]
) -> list[Floats | None]:
    """For each listed object the degree (n,) to which vertices move with the skin; None if it has no weights."""
    if fitting.weights is None:
        return [None] * len(numbers)
    labels = fitting.bones if fitting.rigs is None else (*fitting.bones, *fitting.rigs.outfit.names)
    if fitting.rigs is None:
        given = fitting.weights.worn
    else:
        given = [None if change is None else change.after for change in fit.weights]
    weights = [None if (own := given[number]) is None else weights_of_bones(own, labels) for number in numbers]
    body = WeightedBody(fitting.target, weights_of_bones(fitting.weights.target, labels))
    return moving_with_skin(body, shapes, weights)


def _in_shape(shape: zo.Surface | zo.Lines, vertices: Floats) -> zo.Surface | zo.Lines:
    """The same object with other vertices (n, 3)."""
    return zo.Lines(vertices, shape.edges) if isinstance(shape, zo.Lines) else shape.with_vertices(vertices)


def _hiding_keys(fitting: Fitting) -> Iterator[str]:
    """Names of active shape keys of the source that hide skin below the worn objects."""
    shapes = [each.shape for each in fitting.worn]
    for keys in fitting.active_keys:
        is_hiding = keys_that_hide_skin(keys.surface, keys.offsets, shapes)
        yield from (name for name, hides in zip(keys.names, is_hiding, strict=True) if hides)


def notes_on_hidden_skin(hiding: Collection[str], source: str, target: str, own: Collection[str]) -> list[Message]:
    """Sentences on shape keys of a source that hide skin below the objects, given the names of the target's keys."""
    there, missing = [name for name in hiding if name in own], [name for name in hiding if name not in own]
    notes = []
    if there:
        notes.append(
            message(
                "Shape keys of '{source}' hide skin below these objects: {keys}. '{target}' has them, too; use them if "
                "its skin comes through.",
                source=source,
                target=target,
                keys=enumeration(there),
            )
        )
    if missing:
        notes.append(
            message(
                "Shape keys of '{source}' hide skin below these objects: {keys}. Transfer them to '{target}', and use "
                "them if its skin comes through.",
                source=source,
                target=target,
                keys=enumeration(missing),
            )
        )
    return notes


def body_without_worn(fitting: Fitting) -> tuple[zo.Surface, Booleans]:
    """The source without worn parts, and which of its vertices (n_s,) that has; all of it if no triangle remains."""
    source, is_body = fitting.source, fitting.is_body
    if is_body.all() or not is_body[source.triangles].all(axis=1).any():
        return source, np.ones_like(is_body)
    return source.subset(is_body), is_body


def notes_on_stretch(worn: Sequence[Worn], dressed: Dressed) -> list[Message]:
    """A sentence for each copy that is stretched somewhere."""
    return [
        plural_warning(
            int(stretched.sum()),
            "1 vertex of '{name}' stretches far more than the body, for example where limbs touch: check it.",
            "{count:,} vertices of '{name}' stretch far more than the body, for example where limbs touch: check "
            "these.",
            name=each.name,
        )
        for each, stretched in zip(worn, dressed.stretched, strict=True)
        if stretched.any()
    ]
