"""Work for several targets: prepared one after another, written at the end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeAlias, TypeVar

import zoomout_core as zo
from zoomout_core.runtime.stepping import Progress, Steps

from ..mesh_data import all_or_nothing

Result = TypeVar("Result")
Prepared = TypeVar("Prepared", bound=Callable[[], Any])

WRITING = Progress(1.0, "Writing")

# Writes a prepared result, and returns it.
Write: TypeAlias = Callable[[], Result]


@dataclass(frozen=True)
class Outcome(Generic[Result]):
    """What came of work for several targets.

    Attributes:
        done: the results, by the names of the targets.
        failed: sentences that say why, by the names of the others.
    """

    done: dict[str, Result] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)

    def check(self) -> None:
        """Raise a MeshError if nothing was done."""
        if self.failed and not self.done:
            name, reason = next(iter(self.failed.items()))
            several = f"All {len(self.failed)} targets failed. '{name}': {reason}"
            raise zo.MeshError(several if len(self.failed) > 1 else reason)


def each_target_steps(
    names: Sequence[str],
    work: Callable[[str], Steps[Prepared]],
    together: Callable[[dict[str, Prepared]], Steps[dict[str, Prepared]]] | None = None,
) -> Steps[Outcome[Any]]:
    """Do some work for each of several targets; nothing is written before all of it is done.

    Args:
        names: of the targets.
        work: for the target of a name; returns what writes its result, in no time.
        together: what is done for all of them in the end, where there are several, before it is written.
    """
    outcome: Outcome[Any] = Outcome()
    writes: dict[str, Prepared] = {}
    for i, name in enumerate(names):
        try:
            writes[name] = yield from _one_of(work(name), i, names)
        except zo.MeshError as error:
            outcome.failed[name] = str(error)
    if together is not None and len(writes) > 1:
        writes = yield from together(writes)
    yield WRITING
    with all_or_nothing():  # what is no fault of one target is none of the others', but leaves all as they were
        for name, write in writes.items():
            try:
                outcome.done[name] = write()
            except zo.MeshError as error:
                outcome.failed[name] = str(error)
    return outcome


def _one_of(steps: Steps[Result], i: int, names: Sequence[str]) -> Steps[Result]:
    """The i-th of several computations that are alike, whose progress says which it is."""
    while True:
        try:
            progress = next(steps)
        except StopIteration as finished:
            return finished.value
        place = f"'{names[i]}', {i + 1} of {len(names)}: {progress.stage}"
        yield Progress((i + progress.fraction) / len(names), place if len(names) > 1 else progress.stage)
