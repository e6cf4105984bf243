# SPDX-License-Identifier: GPL-3.0-or-later
"""Register the face of a source to its target, before the source's expression keys are transferred.

A map of whole heads is off by some millimetres on the face, where keys vary most. The source's face is therefore
deformed until it coincides with the target, see `face_piece.py`. Normals distinguish lips and lids whose surfaces face
each other, and sides of the mouth those lips that overlap. Closest points slide along the rims of lids and lips. Rims
that are visible from the front are therefore also attracted by those of the target's eyes and mouth.

Other parts that keys move are registered by themselves, such as gums with a tongue. Lashes follow the skin instead.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from zoomout_core.arrays import Booleans, Floats, Integers, row_norms
from zoomout_core.mesh.triangles import vertex_areas
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.transfer.frames import on_working_mesh
from zoomout_core.transfer.keys.eye_openings import find_eye_opening, match_rims
from zoomout_core.transfer.keys.face_piece import FACE_REGISTRATION, MIN_VERTICES, FacePiece, Guides, Pins
from zoomout_core.transfer.keys.head_directions import HeadDirections
from zoomout_core.transfer.keys.lash_images import attach_lashes
from zoomout_core.transfer.keys.mouth_line import (
    MAX_RATIO,
    MouthLine,
    find_lips,
    find_mouth_line,
    match_lips,
    sides_of_mouth,
)
from zoomout_core.transfer.mapped_target import MappedTarget

# The centre of an eye is the mean of the vertices whose motion in a blink exceeds the first share of the largest one.
# The mean of all moving vertices, as in `face_landmarks`, matches lids less well. Vertices within the second distance,
# relative to that between the eyes, determine the place of an eye on the target.
LID, NEAR_EYE, NEAR_MOUTH = 0.5, 0.25, 0.25


def register_face(offsets: Floats, expressions: list[Floats], mapped: MappedTarget) -> MappedTarget:
    """The target with a map that is more exact on the face, and on parts that keys move: lashes, gums and tongue.

    Takes the offsets (n_s, keys, 3) of all keys of a head, and those of its `find_expressions`. These distinguish the
    skin from other parts. The map is kept where a registration fails, and outside the face.
    """
    source = mapped.source.working
    motion = on_working_mesh(source, np.sqrt(np.einsum("nkx,nkx->nk", offsets, offsets).max(axis=1)))
    moved = motion > FACE_REGISTRATION.moved * motion.max()
    most = on_working_mesh(source, np.sum([row_norms(each) for each in expressions], axis=0))
    skin = int(np.argmax(np.bincount(source.component, most)))
    face = FacePiece.of(moved, skin, mapped)
    if face is None:
        return mapped
    registered = face.register(mapped, _Face.of(face, expressions).guides())
    if registered is None:
        return mapped
    blinks = on_working_mesh(source, np.maximum(*(row_norms(each) for each in expressions[:2])))
    closing = blinks > FACE_REGISTRATION.moved * blinks.max()
    counts = np.bincount(source.component[moved & ~np.isin(source.component, source.component[closing])])
    for component in np.flatnonzero(counts >= MIN_VERTICES):
        piece = FacePiece.of(moved, int(component), mapped)
        if piece is not None:
            registered = piece.register(registered, Guides.none(piece)) or registered
    return attach_lashes(closing, skin, registered)


@dataclass(frozen=True, eq=False)
class _Face:
    """The rims of lids and lips of a face of n vertices."""

    piece: FacePiece
    eyes: tuple[Floats, Floats]  # (3,) the middles of the left and of the right lids
    jaw: Floats  # (3,) the middle of the jaw
    opens: Floats  # (n,) lengths of the motion that opens the mouth
    head: HeadDirections

    @classmethod
    def of(cls, piece: FacePiece, expressions: list[Floats]) -> _Face:
        """The rims of the source's skin, from its expressions (n_s, 3)."""
        left, right, jaw = _middles(piece.mesh, expressions)
        opens = on_working_mesh(piece.mesh, row_norms(expressions[-1]))
        return cls(piece, (left, right), jaw, opens, HeadDirections.of(left, right, jaw))

    def guides(self) -> Guides:
        """Attract the rims of lids and lips by those of the target, and keep the lips apart."""
        piece, mesh, mouth = self.piece, self.piece.mesh, self._find_mouth()
        guides = Guides.none(piece)
        rims, shifts = self._match_lids()
        if mouth is not None:
            is_upper, here, there = mouth
            lips, shifts_of_lips = match_lips(mesh.vertices, is_upper, here, there, self.head)
            rims, shifts = np.concatenate([rims, lips]), np.concatenate([shifts, shifts_of_lips])
            own = sides_of_mouth(mesh.vertices, mesh.triangles, here, self.head)
            other = sides_of_mouth(piece.places, piece.triangles, there, self.head)
            guides = Guides(guides.pins, *(FACE_REGISTRATION.side_weight * each[:, None] for each in (own, other)))
        return replace(guides, pins=Pins.of(rims, shifts, mesh, self.head.forward))

    def _match_lids(self) -> tuple[Integers, Floats]:
        """The vertices (r,) on the rims of the lids, and their shifts (r, 3) to those of the target."""
        piece, head, displacement = self.piece, self.head, self.piece.first_displacement
        vertices = piece.mesh.vertices
        chosen, shifts = [np.empty(0, dtype=np.int64)], [np.empty((0, 3))]
        for eye, inner in zip(self.eyes, (0, -1), strict=True):
            near = row_norms(vertices - eye) < NEAR_EYE * head.size
            here = find_eye_opening(vertices, piece.mesh.triangles, eye, head)
            if here is None or not near.any():
                continue
            moved = eye + displacement[near].mean(axis=0)
            there = find_eye_opening(piece.places, piece.triangles, moved, head)
            if there is not None:
                rim, shift = match_rims(vertices, displacement, here, there, inner, head)
                chosen.append(rim)
                shifts.append(shift)
        return np.concatenate(chosen), np.concatenate(shifts)

    def _find_mouth(self) -> tuple[Booleans, MouthLine, MouthLine] | None:
        """A mask (n,) of the upper half of the face, and the lines between the lips of the source and of the target.

        None if a line is not clear, or if the mouths are of very different width.
        """
        piece, head = self.piece, self.head
        vertices, triangles = piece.mesh.vertices, piece.mesh.triangles
        middle = find_lips(vertices, triangles, self.opens, ((self.eyes[0] + self.eyes[1]) / 2, self.jaw), head)
        if middle is None:
            return None
        near = row_norms(vertices - middle) < NEAR_MOUTH * head.size
        if not near.any():  # lips that are wide apart
            return None
        here = find_mouth_line(vertices, triangles, middle, head)
        moved = middle + piece.first_displacement[near].mean(axis=0)
        there = find_mouth_line(piece.places, piece.triangles, moved, head)
        if here is None or there is None or not 1 / MAX_RATIO < there.width / here.width < MAX_RATIO:
            return None
        return self.opens < self.opens[near].max() / 2, here, there


def _middles(mesh: WorkingMesh, expressions: list[Floats]) -> list[Floats]:
    """The mean position (3,) of the vertices that each expression (n_s, 3) moves most."""
    areas = vertex_areas(mesh.vertices, mesh.triangles)
    motions = [on_working_mesh(mesh, row_norms(each)) for each in expressions]
    return [np.average(mesh.vertices, axis=0, weights=areas * (each >= LID * each.max())) for each in motions]
