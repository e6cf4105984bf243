# SPDX-License-Identifier: GPL-3.0-or-later
"""What a kind of character is: its flesh, its bones, how far they bend, and how individuals differ.

Lengths are metres, angles degrees. A character at rest faces -y and stands on z = 0, and its left is +x.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from zoomout_core.samples.implicit import Ellipsoid, Solid, both_sides
from zoomout_core.samples.skeletons import BoneRow

Range = tuple[float, float]
# How far a bone turns about the axes x, y, z (to the left, to the back, up), in this order, seen from its parent.
Reach = tuple[Range, Range, Range]


@dataclass(frozen=True)
class Build:
    """A trait in which individuals differ: how much thicker and how much longer than usual some bones are.

    Attributes:
        bones: beginnings of the names of the bones that share the trait.
        thickness: least and largest factor across the bones.
        length: the same along the bones; None where they always grow alike in all directions.
    """

    bones: tuple[str, ...]
    thickness: Range
    length: Range | None = None


@dataclass(frozen=True)
class Kind:
    """A kind of character; what lies on the left is mirrored.

    Attributes:
        middle: solids on no side.
        left: solids of the left side.
        middle_bones: bones on no side, parents first.
        left_bones: bones of the left side.
        reach: how far bones turn; those of the right side as the left ones do.
        builds: traits in which individuals differ.
        eye: the left eyeball, a loose part, if there is one.
        dress: beginnings of the names of the bones that clothes cover, for each garment.
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
        """Whether the kind has a left and a right side."""
        return bool(self.left)
