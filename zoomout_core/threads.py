"""Two cores at work: steps side by side, and a BLAS that does not fight over the cores meanwhile.

The products of a match are small. Threads of BLAS gain nothing on them, and where other programs keep the cores
busy they wait for each other, many times as long as the products take.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from functools import wraps
from typing import ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

Yielded = TypeVar("Yielded")
First = TypeVar("First")
Second = TypeVar("Second")
Result = TypeVar("Result")
Arguments = ParamSpec("Arguments")


def side_by_side(
    first: Generator[float, None, First], second: Generator[float, None, Second]
) -> Generator[float, None, tuple[First, Second]]:
    """Run two stepped computations, a step of each at a time, on as many threads.

    Nothing runs on while the caller has the word. numpy and scipy let go of the interpreter in long operations.

    Yields:
        The fraction done.

    Returns:
        What the two return.
    """
    running: dict[int, Generator[float, None, First] | Generator[float, None, Second]] = {0: first, 1: second}
    fractions = [0.0, 0.0]
    results: dict[int, First | Second] = {}
    with ThreadPoolExecutor(max_workers=2) as pool:
        while running:
            futures = {number: pool.submit(next, steps) for number, steps in running.items()}
            for number, future in futures.items():
                try:
                    fractions[number] = future.result()
                except StopIteration as finished:
                    fractions[number], results[number] = 1.0, finished.value
                    del running[number]
            yield sum(fractions) / 2
    return results[0], results[1]  # type: ignore[return-value]


def on_one_blas_thread(
    steps: Callable[Arguments, Generator[Yielded, None, Result]],
) -> Callable[Arguments, Generator[Yielded, None, Result]]:
    """Keep BLAS to one thread in each step of a stepped computation; between them it is as the caller left it."""

    @wraps(steps)
    def limited(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Generator[Yielded, None, Result]:
        running = steps(*args, **kwargs)
        controller = ThreadpoolController()
        while True:
            try:
                with controller.limit(limits=1, user_api="blas"):
                    yielded = next(running)
            except StopIteration as finished:
                return finished.value
            yield yielded

    return limited
