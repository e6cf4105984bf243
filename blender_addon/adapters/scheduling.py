"""All data that was chosen, carried from the source to the target."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import replace

from zoomout_core.runtime.stepping import Steps, spread, within
from zoomout_core.runtime.threads import side_by_side

from .adapter import Cargo, Remarks, Way

# Kinds that take about as long as all others do, and need nothing of theirs.
LONG = ("shape_keys", "shape")


def carry_steps(cargo: Sequence[Cargo], way: Way) -> Steps[None]:
    """Carry everything, shape keys beside the rest."""
    long = [one for one in cargo if one.kind in LONG]
    others = [one for one in cargo if one.kind not in LONG]
    if not (long and others):
        yield from _in_turn(cargo, way)
        return
    # Remarks of their own, so that their order does not depend on who is faster.
    aside = replace(way, remarks=Remarks())
    both = side_by_side(_fractions(others, way), _fractions(long, aside))
    yield from spread(both, 0, 1, "Transferring")
    way.remarks.add(aside.remarks.notes)
    way.remarks.skipped.update(aside.remarks.skipped)


def _in_turn(cargo: Sequence[Cargo], way: Way) -> Steps[None]:
    for i, one in enumerate(cargo):
        yield from within(one.carry(way), i / len(cargo), (i + 1) / len(cargo))


def _fractions(cargo: Sequence[Cargo], way: Way) -> Generator[float, None, None]:
    for progress in _in_turn(cargo, way):
        yield progress.fraction
