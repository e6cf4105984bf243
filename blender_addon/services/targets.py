# SPDX-License-Identifier: GPL-3.0-or-later
"""Work for several targets: it is prepared one after another, and written at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Generic, TypeAlias, TypeVar

import zoomout_core as zo
from zoomout_core.messages import as_message, message
from zoomout_core.runtime.progress import portion, renaming, stage

from ..jobs import Work, pause
from ..mesh_data import all_or_nothing

Result = TypeVar("Result")
Prepared = TypeVar("Prepared", bound=Callable[[], Any])

WRITING = "Writing"

# Writes a prepared result, and returns it.
Write: TypeAlias = Callable[[], Result]


@dataclass(frozen=True)
class Outcome(Generic[Result]):
    """The outcome of work for several targets.

    Attributes:
        done: the results, by the names of the targets.
        failed: the reasons as sentences, by the names of the targets that failed.
    """

    done: dict[str, Result] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)

    def check(self) -> None:
        """Raise a MeshError if all targets failed."""
        if self.failed and not self.done:
            name, reason = next(iter(self.failed.items()))
            if len(self.failed) == 1:
                raise zo.MeshError(reason)
            raise zo.MeshError(
                "All {count} targets failed. '{name}': {reason}", count=len(self.failed), name=name, reason=reason
            )


async def each_target(
    names: Sequence[str],
    work: Callable[[str], Work[Prepared]],
    together: Callable[[dict[str, Prepared]], Work[dict[str, Prepared]]] | None = None,
) -> Outcome[Any]:
    """Do some work for each of several targets; nothing is written before all work is done.

    Args:
        names: names of the targets.
        work: prepares the target of a name, and returns a function that writes its result quickly.
        together: processes the prepared results of several targets together, before they are written.
    """
    outcome: Outcome[Any] = Outcome()
    writes: dict[str, Prepared] = {}
    for i, name in enumerate(names):
        try:
            with _place(i, names):
                writes[name] = await work(name)
        except zo.MeshError as error:
            outcome.failed[name] = str(error)
    if together is not None and len(writes) > 1:
        writes = await together(writes)
    with stage(WRITING, 1):
        await pause()
    with all_or_nothing():  # unexpected errors roll back all targets
        for name, write in writes.items():
            try:
                outcome.done[name] = write()
            except zo.MeshError as error:
                outcome.failed[name] = str(error)
    return outcome


@contextmanager
def _place(i: int, names: Sequence[str]) -> Iterator[None]:
    """A context for the i-th target, whose progress shows its name and number."""

    def numbered_title(title: str) -> str:
        if len(names) == 1:
            return title
        values = {"name": names[i], "number": i + 1, "count": len(names), "title": as_message(title)}
        return message("'{name}', {number} of {count}: {title}", **values)

    with portion(i / len(names), (i + 1) / len(names)), renaming(numbered_title):
        yield
