# SPDX-License-Identifier: GPL-3.0-or-later
"""How transferred values are blended with existing ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from numpy.typing import ArrayLike

from zoomout_core.arrays import check_fractions

Mode: TypeAlias = Literal["mix", "missing"]
MODES: tuple[Mode, ...] = ("mix", "missing")


@dataclass(frozen=True, eq=False)
class Blend:
    """How to blend transferred values with existing ones.

    Attributes:
        mode: "mix": everywhere. "missing": only where values are missing: all numbers of a value are zero, a label is
            zero, false or empty, a vertex has no weight in the groups that share it, or a shape key moves no vertex.
        factor: share of the transferred values, in [0, 1].
        mask: (n_t,) factor for each vertex of the target, which multiplies `factor`; None for 1 everywhere.
    """

    mode: Mode = "mix"
    factor: float = 1.0
    mask: ArrayLike | None = None

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise ValueError(f"The mode is {self.mode!r}: choose one of {', '.join(MODES)}.")
        check_fractions(factor=self.factor)

    @property
    def replaces(self) -> bool:
        """Whether the target's own values are replaced."""
        return self.mode == "mix" and self.factor == 1 and self.mask is None
