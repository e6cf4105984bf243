# SPDX-License-Identifier: GPL-3.0-or-later
"""Shape keys: offsets of vertices, rotated and scaled from the source's pose and size to the target's.

Deformation transfer for triangle meshes (Sumner and Popović 2004) transfers the gradients of a motion, and solves for
the motion with these gradients. With anchors alone it drifts where the target's pose rotates within the moving region,
so the motion is also attracted by the rotated offsets. The offsets determine it over distances longer than
`SHAPE_KEYS.smoothing_length`, the gradients over shorter ones.

Where the map is smooth, the difference of the offsets of neighbours is a good gradient. Errors of the map amplify such
differences: a map that is off by a millimetre tears lips and turns them inside out. There the gradient of the source's
offsets, evaluated at the image, is better.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import bsr_array, csc_array, csr_array

from zoomout_core.arrays import Booleans, Floats, row_norms
from zoomout_core.geometry.gradients import (
    divergence_matrices,
    gradient_matrices,
    turn_gradients,
    without_sums,
)
from zoomout_core.geometry.procrustes import SMALLEST
from zoomout_core.geometry.screened_smoothing import ScreenedSmoothing
from zoomout_core.messages import message, plural, warning
from zoomout_core.runtime.threads import for_each
from zoomout_core.transfer.attribute import Attribute
from zoomout_core.transfer.frames import FULL_CONFIDENCE, MIN_TRUST, Frames, frames_of, frames_on, on_working_mesh
from zoomout_core.transfer.keys.closed_lids import close_lids
from zoomout_core.transfer.keys.face_landmarks import find_expressions, find_slits
from zoomout_core.transfer.keys.face_registration import register_face
from zoomout_core.transfer.keys.joined_lips import has_joined_lips
from zoomout_core.transfer.keys.rigid_keys import move_rigid_parts
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.tuning import Tuning, tuned


@dataclass(frozen=True)
class ShapeKeyTuning(Tuning, set_by="faces"):
    """How gradients determine the motion of a key.

    Attributes:
        smoothing_length: distance beyond which the rotated offsets determine the motion, about the height of a lip.
            Half of it leaves more torn edges; twice as much leaves a larger gap between closed lids.
        deviation: distance between the image of an edge and the rotated and scaled edge, as a share of its length, at
            which the difference of the offsets at its ends has a quarter of its weight.
    """

    smoothing_length: float = tuned(0.01, "at unit area", 1e-6, 1)
    deviation: float = tuned(0.5, "1", 1e-3, 100)


SHAPE_KEYS = ShapeKeyTuning()

# Power of the trust that weights offsets. Edges are weighted by the trust in both ends, about its square, so that a
# higher power leaves doubtful offsets to their surroundings; a lower one leaves them to a wrong map.
OFFSET_POWER = 3
# Keys that are solved together: more need more memory, and are slower.
KEYS_AT_ONCE = 5
# Shorter offsets are noise and are set to zero: lengths relative to the longest offset of the key, and at unit area.
MIN_RELATIVE_OFFSET = 1e-4
MIN_OFFSET = 1e-7
# Motions of vertices without a partner, relative to the longest of the key: those below the first are set to zero, and
# those up to the second fade in. A head's keys hardly move the cut of its neck, but would drift the body below it.
STILL, MOVING = 0.01, 0.03
# Keys that move nothing farther from the eyes than this move a head only. A unit is the distance between the eyes.
HEAD = 5.0
JOINED_LIPS = (
    "The lips of the target are joined, so no key can open its mouth: split them along the line where they meet, then "
    "match and transfer again."
)


def transfer_offsets(attribute: Attribute, mapped: MappedTarget) -> Attribute:
    """Transfer offsets (n_s, keys, 3) of vertices, in the space of the surfaces.

    The source's vertices must be those before keys: the rest shape, if the source is posed after keys are applied.
    Offsets rotate and scale with the target's shape. Vertices where a key does not move the source stay exactly in
    place. The lower the confidence, the larger the surroundings that a vertex follows instead of the map.
    Loose parts that a key moves rigidly on the source also move rigidly on the target.
    """
    offsets = without_noise(np.asarray(attribute.values), mapped.source.area)
    expressions = find_expressions(attribute)
    if expressions is not None:
        mapped = register_face(offsets, expressions, mapped)
    moved = mapped.surface_map.interpolate(offsets.any(axis=(1, 2)).astype(np.float64)) > 0
    doubtful = mapped.confidence < FULL_CONFIDENCE
    transferred = np.zeros((len(doubtful), *offsets.shape[1:]), dtype=offsets.dtype)
    if not moved.any():
        return replace(attribute, values=transferred)
    is_face = expressions is not None and _are_near_eyes(offsets, expressions, mapped.source.vertices)
    frames = frames_on(mapped, moved | doubtful, is_face)
    system = _OffsetTransfer.of(frames)
    other_person = 0.0 if expressions is None else frames.other_person
    growth = frames.growth**other_person

    def transfer_some(first: int) -> None:
        some = slice(first, first + KEYS_AT_ONCE)
        transferred[:, some] = system.transfer(offsets[:, some].astype(np.float64) / growth)

    for_each(transfer_some, range(0, offsets.shape[1], KEYS_AT_ONCE))
    face = None if expressions is None else find_slits(mapped.source, attribute)
    open_blinks = () if face is None else close_lids(transferred, attribute, face, frames)
    move_rigid_parts(transferred, offsets, frames, other_person)
    if mapped.has_partner is not None:
        lacking = ~mapped.has_partner
        transferred[lacking] *= _fade_in(transferred)[lacking, :, None]
    notes = attribute.notes + _note_on_doubts(transferred, doubtful)
    if open_blinks:
        notes += (message("Eyelids close less than on the source: {keys}.", keys=", ".join(open_blinks)),)
    if expressions is not None and face is not None and has_joined_lips(expressions[-1], face, mapped):
        notes += (warning(JOINED_LIPS),)
    return replace(attribute, values=transferred, notes=notes)


def conform_target(mapped: MappedTarget) -> Floats:
    """Positions (n_t, 3) of the target's vertices on the source; the target keeps its own shape at low confidence."""
    target, frames = mapped.target, frames_of(mapped)
    # Trusted images give the gradients; elsewhere the target gives them, rotated by the map.
    own = on_working_mesh(target.working, target.vertices)
    gradients = turn_gradients(frames.doubted_stiffness, np.linalg.inv(frames.turns)) @ own.ravel()
    gradients = gradients.reshape(own.shape) + frames.trusted_stiffness @ frames.points
    conforming = frames.smoothing.fit(frames.points, gradients)
    number = target.working.vertex_of
    return np.where((number >= 0)[:, None], conforming[number], mapped.points)


def without_noise(offsets: Floats, area: float) -> Floats:
    """Set offsets (n, keys, 3) to zero that are too short to be visible on a surface of the given area."""
    length = np.sqrt(np.einsum("nkx,nkx->nk", offsets, offsets))
    least = np.maximum(MIN_RELATIVE_OFFSET * length.max(axis=0), MIN_OFFSET * np.sqrt(area))
    return np.where((length < least)[:, :, None], 0, offsets)


def _fade_in(offsets: Floats) -> Floats:
    """(n, keys) from 0 to 1, by the lengths of offsets (n, keys, 3) relative to the longest of the key."""
    length = np.sqrt(np.einsum("nkx,nkx->nk", offsets, offsets))
    share = length / np.maximum(length.max(axis=0), SMALLEST)
    return np.asarray(np.clip((share - STILL) / (MOVING - STILL), 0, 1))


def _note_on_doubts(offsets: Floats, doubtful: Booleans) -> tuple[str, ...]:
    """A note on the vertices among those that are doubtful (n,) that offsets (n, keys, 3) move visibly."""
    uncertain = int((_fade_in(offsets).any(axis=1) & doubtful).sum())
    note = plural(
        uncertain,
        "Shape keys are uncertain at 1 doubtful vertex: check it.",
        "Shape keys are uncertain at {count:,} doubtful vertices: check these.",
    )
    return (note,) if uncertain else ()


def _are_near_eyes(offsets: Floats, expressions: list[Floats], vertices: Floats) -> bool:
    """Whether keys (n, keys, 3) move only vertices, among places (n, 3), on the head.

    The expressions are those of `find_expressions`.
    """
    blinks = [row_norms(each) for each in expressions[:2]]
    left, right = (blink @ vertices / max(float(blink.sum()), SMALLEST) for blink in blinks)
    moved = vertices[offsets.any(axis=(1, 2))]
    farthest = row_norms(moved - (left + right) / 2).max(initial=0)
    return bool(farthest < HEAD * np.linalg.norm(left - right))


@dataclass(frozen=True, eq=False)
class _OffsetTransfer:
    """Data shared by all keys: the system for the offsets of n vertices of the target's working mesh."""

    frames: Frames
    turns_back: Floats  # (n, 3, 3) inverses of the turns
    differences: bsr_array  # (3n, 3n) divergence of differences of offsets, see `turn_gradients`
    gradient: tuple[csr_array, ...]  # three (n_s, n_s), see `gradient_matrices`
    divergence: tuple[csr_array, ...]  # three (n, n), see `divergence_matrices`
    smoothing: ScreenedSmoothing

    @classmethod
    def of(cls, frames: Frames) -> _OffsetTransfer:
        """Prepare the system for a target with the given frames.

        An edge p_i - p_j of the target, with the image q_i - q_j, has the difference of offsets

            G (p_i - p_j) + a M (o_i - o_j - G (q_i - q_j)),

        where M rotates offsets, G are the rotated gradients of the source's offsets, and a is the weight of the second
        order.
        """
        source, working, turns = frames.mapped.source, frames.mapped.target.working, frames.steady_turns
        stiffness = csr_array(frames.trusted_stiffness)
        row, column = np.repeat(np.arange(len(turns)), np.diff(stiffness.indptr)), stiffness.indices
        places, images = working.scale * working.vertices[frames.number], frames.points[frames.number]
        steps = places[row] - places[column]
        turned = np.einsum("exy,ey->ex", (turns[row] + turns[column]) / 2, images[row] - images[column])
        apart, length = row_norms(steps - turned), row_norms(steps)
        deviation = np.divide(apart, length, out=np.zeros_like(length), where=length > 0) / SHAPE_KEYS.deviation
        share = 1 / (1 + deviation**2) ** 2
        similar = csc_array(csr_array((share * stiffness.data, column, stiffness.indptr), shape=stiffness.shape))
        return cls(
            frames,
            np.linalg.inv(turns),
            turn_gradients(without_sums(similar), turns),
            gradient_matrices(source.vertices, source.triangles),
            divergence_matrices(stiffness, steps - share[:, None] * turned),
            ScreenedSmoothing.of(
                np.maximum(frames.trust**OFFSET_POWER, MIN_TRUST) * frames.areas,
                frames.trusted_stiffness + frames.doubted_stiffness,
                SHAPE_KEYS.smoothing_length,
            ),
        )

    def transfer(self, offsets: Floats) -> Floats:
        """Offsets (n_t, keys, 3) of the target's vertices, from those (n_s, keys, 3) of the source's."""
        frames, target = self.frames, self.frames.mapped.target
        turns = frames.steady_turns.transpose(0, 2, 1)
        plain = frames.mapped.surface_map.interpolate(offsets)
        here = on_working_mesh(target.working, plain)[frames.number]
        divergence = self._divergence_of_differences(here) + self._divergence_of_gradients(offsets)
        solved = self.smoothing.fit((here @ turns).reshape(len(here), -1), divergence).reshape(here.shape)
        motion = np.zeros((len(target.working.vertices), *here.shape[1:]))
        motion[frames.number] = solved * (here.any(axis=2) | (frames.trust < 1)[:, None])[:, :, None]

        number = target.working.vertex_of
        transferred = motion[number]
        loose = np.flatnonzero(number < 0)
        if len(loose):
            transferred[loose] = plain[loose] @ turns[frames.nearest(target.vertices[loose])]
        return without_noise(transferred, target.area)

    def _divergence_of_differences(self, here: Floats) -> Floats:
        """The divergence (n, 3 keys) of the differences between neighbours' offsets (n, keys, 3)."""
        n, keys, _ = here.shape
        divergence = self.differences @ here.transpose(0, 2, 1).reshape(3 * n, keys)
        return np.asarray(divergence.reshape(n, 3, keys).transpose(0, 2, 1).reshape(n, 3 * keys))

    def _divergence_of_gradients(self, offsets: Floats) -> Floats:
        """The divergence (n, 3 keys) of the gradients of offsets (n_s, keys, 3) on the source."""
        columns = offsets.reshape(len(offsets), -1)
        around = np.stack([component @ columns for component in self.gradient], axis=-1)
        images = self.frames.mapped.surface_map.interpolate(around.reshape(*offsets.shape, 3))
        here = on_working_mesh(self.frames.mapped.target.working, images)[self.frames.number]
        turned = self.frames.steady_turns[:, None] @ here @ self.turns_back[:, None]
        x, y, z = turned.reshape(len(here), -1, 3).transpose(2, 0, 1)
        along_x, along_y, along_z = self.divergence
        return np.asarray(along_x @ x + along_y @ y + along_z @ z)
