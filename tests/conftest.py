"""What the tests of several rooms have in common."""

from __future__ import annotations

import pickle
from collections import OrderedDict
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from zoomout_core import MatchResult
    from zoomout_core.runtime.stepping import Progress, Steps

BENCHMARK_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

# The matches of this process that were asked for last, which tests of other modules may ask for again.
_matches: OrderedDict[bytes, tuple[list[Progress], MatchResult]] = OrderedDict()
MOST_MATCHES = 60
# What a shape is known by.
ARRAYS = "vertices", "corner_vertex", "face_start", "triangle_corners", "points", "normals"


@pytest.fixture(scope="session")
def benchmark_data() -> Path:
    """The folder of public research meshes, which the tests must also pass without."""
    if not BENCHMARK_DATA.is_dir():
        pytest.skip("the benchmark meshes are not here")
    return BENCHMARK_DATA


@pytest.fixture(scope="module")
def remembered_matches() -> Iterator[None]:
    """A match that is asked for again is the one that came of it before, with the same progress.

    For modules that are about what becomes of matches: these are deterministic, and take most of the time.
    """
    import zoomout_core as zo  # after bpy, where that is imported

    match = zo.match_steps

    def match_steps(source: Any, target: Any, **options: Any) -> Steps[MatchResult]:
        shapes = [[getattr(shape, name, None) for name in ARRAYS] for shape in (source, target)]
        key = sha256(pickle.dumps((shapes, sorted(options.items())))).digest()
        if key in _matches:
            _matches.move_to_end(key)
            told, result = _matches[key]
            yield from told
            return result
        told = []
        steps = match(source, target, **options)
        while True:
            try:
                told.append(next(steps))
            except StopIteration as finished:
                _matches[key] = told, finished.value
                if len(_matches) > MOST_MATCHES:
                    _matches.popitem(last=False)
                return finished.value
            yield told[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(zo, "match_steps", match_steps)
        yield
