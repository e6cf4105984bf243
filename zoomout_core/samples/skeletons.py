# SPDX-License-Identifier: GPL-3.0-or-later
"""Skeletons as tables of bones."""

from __future__ import annotations

from typing import NamedTuple

Point = tuple[float, float, float]


class BoneRow(NamedTuple):
    """A row of the skeleton: a bone, its parent, its start and its end."""

    name: str
    parent: str | None
    head: Point
    tail: Point

    def mirrored(self) -> BoneRow:
        """The mirrored bone of the other side."""
        (hx, hy, hz), (tx, ty, tz) = self.head, self.tail
        parent = self.parent and self.parent.replace(".L", ".R")
        return BoneRow(self.name.replace(".L", ".R"), parent, (-hx, hy, hz), (-tx, ty, tz))


def chain_of_bones(name: str, parent: str, *points: Point, side: str = "") -> list[BoneRow]:
    """Bones NAME_1, NAME_2, ... from point to point; the first is a child of the parent."""
    names = [f"{name}_{i}{side}" for i in range(1, len(points))]
    return [BoneRow(*row) for row in zip(names, [parent, *names], points[:-1], points[1:], strict=False)]
