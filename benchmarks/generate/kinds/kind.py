# SPDX-License-Identifier: GPL-3.0-or-later
"""The definition of a kind of character: solids, bones, ranges of joints, and differences between individuals.

Lengths are in metres, angles in degrees. A character at rest faces -y and stands on z = 0; its left is +x.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from zoomout_core.samples.implicit import Ellipsoid, Solid, both_sides
from zoomout_core.samples.skeletons import BoneRow

Range = tuple[float, float]
# Ranges of rotation of a bone about x, y, z (left, back, up), in this order, relative to its parent.
Reach = tuple[Range, Range, Range]


@dataclass(frozen=True)
class Build:
    """A trait in which individuals differ: relative thickness and length of some bones.

    Attributes:
        bones: prefixes of the names of the bones that share the trait.
        thickness: minimum and maximum factor across the bones.
        length: the same along the bones; None if they are scaled uniformly.
    """

    bones: tuple[str, ...]
    thickness: Range
    length: Range | None = None


@dataclass(frozen=True)
class Kind:
    """A kind of character; everything on the left is mirrored to the right.

    Attributes:
        middle: solids on neither side.
        left: solids of the left side.
        middle_bones: bones on neither side, parents first.
        left_bones: bones of the left side.
        reach: ranges of rotation of the bones; the right side's equal the left side's.
        builds: traits in which individuals differ.
        eye: the left eyeball, a loose part, if there is one.
        dress: prefixes of the names of the bones that each garment covers.
    """

    middle: list[Solid]
    left: list[Solid]
    middle_bones: list[BoneRow]
    left_bones: list[BoneRow]
    reach: Mapping[str, Reach]
    builds: list[Build]
    eye: Ellipsoid | None = None
    dress: tuple[tuple[str, ...], ...] = ()

    @cached_property
    def solids(self) -> list[Solid]:
        """The solids of both sides."""
        return self.middle + both_sides(self.left)

    @cached_property
    def bones(self) -> list[BoneRow]:
        """The bones of both sides."""
        return self.middle_bones + self.left_bones + [row.mirrored() for row in self.left_bones]

    @property
    def symmetric(self) -> bool:
        """Whether the kind has left and right sides."""
        return bool(self.left)
