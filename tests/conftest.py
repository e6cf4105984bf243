# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures and options shared by all tests."""

from __future__ import annotations

import gc
import os
import pickle
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator
from functools import cache, partial, wraps
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from zoomout_core.runtime.progress import Progress
    from zoomout_core.tuning import Tuning

BENCHMARK_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

# Test files run in parallel, one on each core, so more threads would only compete for the cores.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("ZOOMOUT_THREADS", "1")

# Results of the last calls of long functions in this process, which tests of other modules may repeat.
_results: OrderedDict[bytes, tuple[list[Progress], Any]] = OrderedDict()
MAX_RESULTS = 80
# The modules of the command line that import these functions by name.
COMMANDS = [f"zoomout_core.cli.{name}_command" for name in ("landmarks", "match", "symmetry", "transfer")]
# Arrays that identify a shape.
ARRAYS = "vertices", "corner_vertex", "face_start", "triangle_corners", "points", "normals"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="run slow tests, too")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers",
        "slow(but=0): run only with --slow, as in `make test-all`, or if the test is named with `::`; a quicker test "
        "covers the essentials. The first `but` sets of parameters always run.",
    )


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Disable garbage collection while tests are collected: their objects stay, and it takes up to a fifth."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--slow") or any("::" in argument for argument in config.args):
        return
    seen: Counter[str] = Counter()
    chosen, left_out = [], []
    for item in items:
        slow = item.get_closest_marker("slow")
        function = item.nodeid.partition("[")[0]
        seen[function] += 1
        is_left_out = slow is not None and seen[function] > slow.kwargs.get("but", 0)
        (left_out if is_left_out else chosen).append(item)
    config.hook.pytest_deselected(items=left_out)
    items[:] = chosen


@pytest.fixture(scope="session")
def benchmark_data() -> Path:
    """The folder of public research meshes, which the tests must also pass without."""
    if not BENCHMARK_DATA.is_dir():
        pytest.skip("the benchmark meshes are not here")
    return BENCHMARK_DATA


@cache
def known_stages() -> dict[str, Tuning]:
    """All stages, which tests retune in place: looking for their modules takes as long as a small computation."""
    from zoomout_core.tuning import stages

    return stages()


def remember(function: Callable[..., Any], shapes: int) -> Callable[..., Any]:
    """Cache a function whose first `shapes` arguments are shapes and whose others are options."""

    @wraps(function)
    def run(*given: Any, progress: Callable[[Progress], object] | None = None, **options: Any) -> Any:
        from zoomout_core.runtime.progress import listening, show_outlines, stage

        known = [[getattr(shape, name, None) for name in ARRAYS] for shape in given[:shapes]]
        asked = function.__name__, known, given[shapes:], sorted(options.items()), repr(known_stages())
        key = sha256(pickle.dumps(asked)).digest()
        if key in _results:
            _results.move_to_end(key)
            told, result = _results[key]
            with listening(progress):
                for one in told:
                    with stage(one.stage, one.fraction, one.fraction):
                        if one.outlines:
                            show_outlines(partial(getattr, one, "outlines"))
            return result
        told = []
        with listening(progress), listening(told.append):
            result = function(*given, **options)
        _results[key] = told, result
        if len(_results) > MAX_RESULTS:
            _results.popitem(last=False)
        return result

    return run


@pytest.fixture(scope="module")
def few_candidates() -> Iterator[None]:
    """Matches search among fewer candidates, which is faster: the search itself is tested in `core/matching`."""
    from zoomout_core.matching.hypotheses.extremities import EXTREMITIES
    from zoomout_core.matching.ranking.rank import RANKING
    from zoomout_core.tuning import retune

    with (
        retune(RANKING, direct=(2, 4), mirrored=(1, 2)),
        retune(EXTREMITIES, quotas=(20, 6, 2, 1), kept_consistent=3, kept=6),
    ):
        yield


@pytest.fixture(scope="module")
def quick_search(few_candidates: None) -> Iterator[None]:
    """Matches search once among fewer candidates, and matches, wraps and poses are refined in fewer rounds.

    For modules that use them: these computations themselves are tested in `core/matching` and `core/transfer`.
    """
    from zoomout_core.matching import retry
    from zoomout_core.matching.ranking.finished_maps import FINISHED_MAPS
    from zoomout_core.matching.refinement.refine import REFINEMENT, Schedule
    from zoomout_core.matching.registration import nonrigid_icp
    from zoomout_core.matching.registration.nonrigid_icp import Level
    from zoomout_core.transfer.rigging.rest_pose import REST
    from zoomout_core.transfer.wrapping.fit import FIT
    from zoomout_core.tuning import retune

    few_levels = Level(40, 1.0, 0.3, 1), Level(40, 0.01, 0.3, 3), Level(100, 0.02, 0.3, 1), Level(200, 0.02, 0.1, 1)
    with (
        retune(FINISHED_MAPS, max_refined=2),
        retune(REFINEMENT, between_shapes=Schedule(((30, 0.08), (60, 0.06), (120, 0.04)), (90, 120))),
        retune(FIT, stages=3, rounds=3, last_rounds=2),
        retune(REST, rounds=2, iterations=4),
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setattr(nonrigid_icp, "NONRIGID_SCHEDULE", few_levels)
        patch.setattr(retry, "_with_more_guesses", lambda attempt, *_: attempt)
        yield


@pytest.fixture(scope="module")
def coarse_hulls() -> Iterator[None]:
    """The hulls of meshes have an eighth of the voxels."""
    from zoomout_core.matching.components.hulls import HULLS
    from zoomout_core.tuning import retune

    with retune(HULLS, resolution=64, tight_resolution=96):
        yield


@pytest.fixture(scope="module")
def remember_matches(quick_search: None) -> Iterator[None]:
    """A repeated match or symmetry detection returns the earlier result, and reports the same progress.

    For modules that use these results: the computations are deterministic, and take most of the time.
    """
    import zoomout_core as zo  # after bpy, where that is imported

    remembered = {zo.match: remember(zo.match, 2), zo.detect_symmetry: remember(zo.detect_symmetry, 1)}
    with pytest.MonkeyPatch.context() as patch:
        for function, other in remembered.items():
            patch.setattr(zo, function.__name__, other)
        for module in map(import_module, COMMANDS):
            for name, function in list(vars(module).items()):
                if getattr(function, "__name__", "") in ("match", "detect_symmetry"):
                    patch.setattr(module, name, remembered[function])
        yield
