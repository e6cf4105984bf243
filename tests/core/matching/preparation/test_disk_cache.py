# SPDX-License-Identifier: GPL-3.0-or-later
"""The disk cache changes no map, survives damaged files, and stays within its size limit."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from creatures import creature
from reports import fractions_of

import zoomout_core as zo
from zoomout_core.matching.preparation import memory_cache
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.preparation.disk_cache import ShapeFolder

pytestmark = pytest.mark.usefixtures("few_candidates")

COUNT = 2500  # large enough to be decimated
PROXY_VERTICES = 1000
NUMBERS = {"k_final": 40, "proxy_vertices": PROXY_VERTICES}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path) -> Iterator[Path]:
    zo.forget_shapes()
    zo.store_shapes(tmp_path)
    yield tmp_path
    zo.store_shapes(None)
    zo.forget_shapes()


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """List that grows by one with each newly computed shape."""
    calls: list[int] = []
    original = memory_cache.analyse
    monkeypatch.setattr(memory_cache, "analyse", lambda *args: (calls.append(1), original(*args))[1])
    return calls


def analyse_cached(count: int = COUNT, proxy_vertices: int | None = PROXY_VERTICES) -> ShapeAnalysis:
    zo.forget_shapes()
    part, _ = creature(count).surface.working.part(0)
    return memory_cache.cached_analysis(part, 40, 300, 0, proxy_vertices)


@pytest.fixture(scope="module")
def small() -> ShapeAnalysis:
    part, _ = creature(60).surface.working.part(0)
    return analyse(part, 10, 20, 0)


def test_full_folder_evicts_the_oldest_shapes(tmp_path: Path, small: ShapeAnalysis) -> None:
    shapes = ShapeFolder(tmp_path / "made" / "on the way")
    shapes.save(b"a", small)
    (path,) = tmp_path.rglob("*.npz")
    shapes = ShapeFolder(tmp_path / "made" / "on the way", int(2.5 * path.stat().st_size))
    for number, key in enumerate((b"b", b"c", b"d")):
        for file in tmp_path.rglob("*.npz"):
            os.utime(file, (file.stat().st_mtime - 100,) * 2)
        shapes.save(key, small)
        assert [shapes.load(each, small.proxy.full) is not None for each in (b"a", b"b", b"c", b"d")] == [
            [True, True, False, False],
            [False, True, True, False],
            [False, False, True, True],
        ][number]


class Harmful:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (self.path,)


def test_code_in_a_cache_file_is_not_run(tmp_path: Path, small: ShapeAnalysis) -> None:
    shapes = ShapeFolder(tmp_path)
    shapes.save(b"a", small)
    (path,) = tmp_path.rglob("*.npz")
    np.savez(path, eigenvalues=np.array([Harmful(tmp_path / "run")], dtype=object))
    assert shapes.load(b"a", small.proxy.full) is None
    assert not (tmp_path / "run").exists()


def test_progress_of_storing_stays_within_its_bounds(folder: Path, small: ShapeAnalysis) -> None:
    fractions = fractions_of(lambda: memory_cache.cached_analysis(small.proxy.full, 10, 20, 0, None))
    assert fractions == sorted(fractions)
    assert fractions[0] >= 0
    assert 0.8 < fractions[-1] <= 1


@pytest.mark.parametrize("proxy_vertices", [None, PROXY_VERTICES])
def test_stored_shape_equals_the_computed_one(computed: list[int], proxy_vertices: int | None) -> None:
    first, again = analyse_cached(COUNT, proxy_vertices), analyse_cached(COUNT, proxy_vertices)
    assert len(computed) == 1
    assert again is not first
    for name in ("basis.eigenvectors", "basis.eigenvalues", "basis.areas", "sampled.rows", "distances"):
        holder, _, attribute = f".{name}".rpartition(".")
        ours, theirs = (getattr(getattr(s, holder[1:]) if holder[1:] else s, attribute) for s in (first, again))
        np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(first.stiffness.toarray(), again.stiffness.toarray())
    np.testing.assert_array_equal(first.proxy.place.triangle, again.proxy.place.triangle)
    np.testing.assert_array_equal(first.mesh.oriented_triangles, again.mesh.oriented_triangles)
    assert again.mesh.scale == first.mesh.scale
    assert (again.mesh is again.proxy.full) == (proxy_vertices is None)


@pytest.mark.slow
def test_match_in_another_process_uses_the_cache(folder: Path, tmp_path: Path) -> None:
    source, target = (creature(COUNT, seed=seed).surface for seed in (0, 1))
    first = zo.match(source, target, **NUMBERS).surface_map
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*.npz")}
    assert len(before) == 2
    np.savez(
        tmp_path / "meshes",
        **{f"{n}{i}": a for i, s in enumerate((source, target)) for n, a in (("v", s.vertices), ("t", s.triangles))},
    )
    code = f"""
import numpy as np, zoomout_core as zo
from zoomout_core.matching.preparation import memory_cache
def analyse(*args): raise AssertionError("prepared again")
memory_cache.analyse = analyse
zo.store_shapes({str(folder)!r})
m = np.load({str(tmp_path / "meshes.npz")!r})
result = zo.match(*(zo.Surface(m[f"v{{i}}"], m[f"t{{i}}"]) for i in (0, 1)), **{NUMBERS!r})
np.savez({str(tmp_path / "map")!r}, triangle=result.surface_map.triangle)
"""
    subprocess.run([sys.executable, "-c", code], check=True, env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)})
    with np.load(tmp_path / "map.npz") as file:
        np.testing.assert_array_equal(file["triangle"], first.triangle)


@pytest.mark.parametrize("damage", ["cut off", "no zip", "other arrays"])
def test_unreadable_file_is_recomputed_and_replaced(
    folder: Path, computed: list[int], damage: str, caplog: pytest.LogCaptureFixture
) -> None:
    first = analyse_cached()
    (path,) = folder.rglob("*.npz")
    if damage == "cut off":
        path.write_bytes(path.read_bytes()[:5000])
    elif damage == "no zip":
        path.write_bytes(b"nothing of use")
    else:
        np.savez(path, eigenvalues=np.zeros(3))
    with caplog.at_level(logging.WARNING):
        again = analyse_cached()
    assert "cannot be read" in caplog.text
    assert len(computed) == 2
    np.testing.assert_array_equal(first.basis.eigenvectors, again.basis.eigenvectors)
    analyse_cached()
    assert len(computed) == 2


def test_cache_files_contain_no_pickles(folder: Path) -> None:
    analyse_cached()
    (path,) = folder.rglob("*.npz")
    with np.load(path, allow_pickle=False) as file:
        assert all(file[name].dtype != object for name in file.files)


def test_least_recently_used_shapes_are_evicted(folder: Path, computed: list[int]) -> None:
    analyse_cached(COUNT)
    (path,) = folder.rglob("*.npz")
    zo.store_shapes(folder, int(2.5 * path.stat().st_size))
    analyse_cached(COUNT + 1)
    for age, file in enumerate(sorted(folder.rglob("*.npz"), key=lambda file: file.stat().st_mtime)):
        os.utime(file, (age, age))
    analyse_cached(COUNT)  # used again, so the other one is evicted
    analyse_cached(COUNT + 2)
    assert len(list(folder.rglob("*.npz"))) == 2
    assert len(computed) == 3
    analyse_cached(COUNT)
    assert len(computed) == 3
    analyse_cached(COUNT + 1)
    assert len(computed) == 4


def test_leftover_files_of_dead_processes_are_removed(folder: Path) -> None:
    analyse_cached(COUNT)
    (path,) = folder.rglob("*.npz")
    old, young = path.with_name(".0123abcd.part.npz"), path.with_name(".4567cdef.part.npz")
    old.touch()
    young.touch()
    os.utime(old, (0, 0))
    analyse_cached(COUNT + 1)
    assert not old.exists()
    assert young.exists()  # another process may be writing it


def test_unwritable_folder_is_reported_and_harmless(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "file").touch()
    zo.store_shapes(tmp_path / "file")
    with caplog.at_level(logging.WARNING):
        assert len(analyse_cached().basis.eigenvalues) == 40
    assert "cannot be cached" in caplog.text


@pytest.mark.slow
def test_concurrent_processes_share_the_cache_safely(folder: Path) -> None:
    code = f"""
import sys; sys.path[:0] = {sys.path!r}
import zoomout_core as zo
from creatures import creature
from reports import fractions_of
from zoomout_core.matching.preparation.memory_cache import cached_analysis
zo.store_shapes({str(folder)!r}, 3_000_000)
for number in range(6):
    zo.forget_shapes()
    part, _ = creature(1300 + number % 3).surface.working.part(0)
    assert len(cached_analysis(part, 30, 100, 0, None).basis.eigenvalues) == 30
"""
    running = [subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE) for _ in range(3)]
    for process in running:
        _, errors = process.communicate(timeout=300)
        assert process.returncode == 0, errors.decode()
        assert b"cannot" not in errors
    assert not list(folder.rglob(".*"))
