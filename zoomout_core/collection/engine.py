# SPDX-License-Identifier: GPL-3.0-or-later
"""Tasks, the interface of engines that run them, and the engine of this process."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from zoomout_core.mesh.memory import NotEnoughMemoryError
from zoomout_core.messages import NO_MEMORY, message_of
from zoomout_core.runtime.progress import renaming, stage


@dataclass(frozen=True)
class Failure:
    """A failed task; the message says why, in a sentence."""

    message: str


@dataclass(frozen=True)
class Task:
    """A piece of work.

    Attributes:
        key: unique key.
        function: does the work; importable by name in other processes.
        arguments: arguments of the function.
        after: keys of earlier tasks, whose results are further arguments.
    """

    key: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    after: tuple[str, ...] = ()


@dataclass(frozen=True)
class Done:
    """A task that has ended, and its result: a `Failure` if it failed."""

    key: str
    result: Any


class Engine(Protocol):
    """Runs tasks, each after those that it depends on."""

    def as_completed(self, tasks: Sequence[Task]) -> Iterator[Done]:
        """Run tasks, and yield each when it has ended; progress is reported while they run.

        A failure affects only the task itself and those that depend on it.
        """
        ...

    def sees(self, paths: Sequence[Path]) -> bool:
        """Whether files are there wherever tasks run."""
        ...


def run_tasks(engine: Engine, tasks: Sequence[Task], title: Callable[[int], str]) -> Iterator[Done]:
    """Run tasks, and yield each when it has ended, with the progress of the whole.

    `title` returns the title of the progress for the number of finished tasks.
    """
    if not tasks:
        return
    running = engine.as_completed(tasks)
    for ended in range(len(tasks) + 1):
        with stage(title(ended), ended / len(tasks), min(1.0, (ended + 1) / len(tasks))):
            done = next(running, None)
        if done is None:
            return
        yield done


def attempt(function: Callable[..., Any], *arguments: Any) -> Any:
    """The result of a task; a Failure if an argument is one, or if the input is invalid.

    Errors that may not occur again, such as a lack of memory, are raised.
    """
    failed = next((each for each in arguments if isinstance(each, Failure)), None)
    if failed is not None:
        return failed
    try:
        return function(*arguments)
    except NotEnoughMemoryError:
        raise
    except ValueError as error:  # a retry would fail alike
        return Failure(str(error))


class InThisProcess:
    """Runs one task after the other, with retries of failures that may pass, such as a lack of memory.

    Their progress is reported without the titles of their stages.
    """

    def __init__(self, retries: int = 0) -> None:
        self._retries = retries

    def sees(self, paths: Sequence[Path]) -> bool:
        return True

    def as_completed(self, tasks: Sequence[Task]) -> Iterator[Done]:
        results: dict[str, Any] = {}
        for task in tasks:
            arguments = (*task.arguments, *(results[key] for key in task.after))
            with renaming(lambda _: ""):
                results[task.key] = self._result(task, arguments)
            yield Done(task.key, results[task.key])

    def _result(self, task: Task, arguments: tuple[Any, ...]) -> Any:
        """The result of a task, with retries after temporary failures."""
        for tries_left in reversed(range(self._retries + 1)):
            try:
                return attempt(task.function, *arguments)
            except Exception as error:  # one of thousands of tasks must not end the others
                if not tries_left:
                    return Failure(sentence_of(error))
        raise AssertionError


def sentence_of(error: BaseException | None) -> str:
    """Why a task failed, for the report."""
    kind = type(error).__name__
    if isinstance(error, MemoryError):
        return NO_MEMORY
    if kind == "KilledWorker":
        return "Its worker process was killed every time: it may need more memory than is available."
    if error is None:
        return "It was abandoned when its worker was lost."
    if isinstance(error, OSError | NotEnoughMemoryError):
        return message_of(error)
    return f"It failed unexpectedly ({kind}: {' '.join(str(error).split())})."
