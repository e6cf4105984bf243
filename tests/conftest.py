"""What the tests of several rooms have in common."""

from __future__ import annotations

import pickle
from collections import OrderedDict
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from zoomout_core.runtime.stepping import Progress, Steps

BENCHMARK_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

# What the long functions of this process came to that were asked for last, which tests of other modules may ask for
# again.
_results: OrderedDict[bytes, tuple[list[Progress], Any]] = OrderedDict()
MOST_RESULTS = 80
# What a shape is known by.
ARRAYS = "vertices", "corner_vertex", "face_start", "triangle_corners", "points", "normals"


@pytest.fixture(scope="session")
def benchmark_data() -> Path:
    """The folder of public research meshes, which the tests must also pass without."""
    if not BENCHMARK_DATA.is_dir():
        pytest.skip("the benchmark meshes are not here")
    return BENCHMARK_DATA


def remembered(function: Callable[..., Steps[Any]], shapes: int) -> Callable[..., Steps[Any]]:
    """A stepped function of so many shapes and of options, which is run once for the same ones."""

    def steps(*given: Any, **options: Any) -> Steps[Any]:
        known = [[getattr(shape, name, None) for name in ARRAYS] for shape in given[:shapes]]
        key = sha256(pickle.dumps((function.__name__, known, given[shapes:], sorted(options.items())))).digest()
        if key in _results:
            _results.move_to_end(key)
            told, result = _results[key]
            yield from told
            return result
        told = []
        run = function(*given, **options)
        while True:
            try:
                told.append(next(run))
            except StopIteration as finished:
                _results[key] = told, finished.value
                if len(_results) > MOST_RESULTS:
                    _results.popitem(last=False)
                return finished.value
            yield told[-1]

    return steps


@pytest.fixture(scope="module")
def remembered_matches() -> Iterator[None]:
    """A match or a symmetry that is asked for again is what came of it before, with the same progress.

    For modules that are about what becomes of these: they are deterministic, and take most of the time.
    """
    import zoomout_core as zo  # after bpy, where that is imported

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(zo, "match_steps", remembered(zo.match_steps, 2))
        patch.setattr(zo, "detect_symmetry_steps", remembered(zo.detect_symmetry_steps, 1))
        yield
