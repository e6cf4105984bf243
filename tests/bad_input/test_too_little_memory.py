# SPDX-License-Identifier: GPL-3.0-or-later
"""If memory runs out at any step, every entry point of the core says so in a sentence and writes nothing."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from creatures import creature
from interfaces import add_colors, assert_refused, contents, run
from scipy.sparse import csr_array

import zoomout_core as zo
from zoomout_core import __main__ as entry
from zoomout_core.cli import main
from zoomout_core.matching.preparation import memory_need
from zoomout_core.messages import NO_MEMORY
from zoomout_core.transfer import WeightedBody, follow_weights

SOURCE, TARGET = (creature(260, seed=seed).surface for seed in (0, 1))
MAP = zo.SurfaceMap.from_vertices(np.zeros(260, dtype=int), SOURCE)
WORN = WeightedBody(SOURCE, csr_array(np.ones((260, 1))))
VALUES = zo.Attribute("a", zo.Domain.POINT, zo.Kind.SCALAR, np.zeros(260))
NUMBERS = {"k_final": 20, "samples": 60, "initial": "proximity"}
CORE: dict[str, tuple[Callable[[], object], str]] = {
    "match while refining": (lambda: zo.match(SOURCE, TARGET, **NUMBERS), "matching.refinement.dense_map:refine"),
    "match while lifting": (lambda: zo.match(SOURCE, TARGET, **NUMBERS), "matching.result:lift"),
    "match while reading": (lambda: zo.match(SOURCE, TARGET, **NUMBERS), "matching.pipeline:cached_working_mesh"),
    "nearest points": (lambda: zo.match_by_proximity(SOURCE, TARGET), "matching.proximity:closest_points"),
    "symmetry": (lambda: zo.detect_symmetry(SOURCE, k_final=20), "symmetry.detect:rank"),
    "transfer": (lambda: zo.transfer(VALUES, MAP, SOURCE, TARGET), "transfer.rules:transfer_along"),
    "conform": (lambda: zo.conform(MAP, SOURCE, TARGET), "transfer.rules:conform_target"),
    "wrap": (lambda: zo.wrap(MAP, SOURCE, TARGET), "transfer.wrapping.wrap:map_target"),
    "dress": (lambda: zo.dress(MAP, SOURCE, TARGET, [SOURCE]), "transfer.dressing.dress:fit_to_shape"),
    "keys of clothes": (
        lambda: zo.follow_keys(SOURCE, np.zeros((260, 1, 3)), [SOURCE]),
        "transfer.dressing.body_keys:Patches",
    ),
    "weights of clothes": (
        lambda: follow_weights(WORN, WORN, [SOURCE], [SOURCE.vertices], [WORN.weights]),
        "transfer.dressing.body_weights:Patches",
    ),
}
COMMANDS: dict[str, tuple[tuple[str, ...], str]] = {
    "match": (
        ("match", "source.ply", "target.ply", "--initial", "proximity", "-o", "map.npz"),
        "matching.result:lift",
    ),
    "match nearest": (
        ("match", "source.ply", "target.ply", "--initial", "nearest", "-o", "map.npz"),
        "matching.proximity:closest_points",
    ),
    "match, reading": (("match", "source.ply", "target.ply", "-o", "map.npz"), "mesh.formats.files:existing"),
    "symmetry": (("symmetry", "source.ply", "-o", "map.npz"), "symmetry.detect:rank"),
    "info": (("info", "source.ply"), "assets.files:existing"),
    "transfer": (("transfer", "source.ply", "target.ply", "-o", "out.ply"), "cli.transfer_command:match"),
}


def without_memory(monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    """Let a function of the core run out of memory."""
    module, _, name = place.partition(":")

    def failing(*_: object, **__: object) -> None:
        raise MemoryError

    assert hasattr(import_module(f"zoomout_core.{module}"), name)
    monkeypatch.setattr(import_module(f"zoomout_core.{module}"), name, failing)


@pytest.mark.parametrize("case", CORE)
def test_functions_report_too_little_memory(monkeypatch: pytest.MonkeyPatch, case: str) -> None:
    call, place = CORE[case]
    without_memory(monkeypatch, place)
    zo.forget_shapes()
    with pytest.raises(zo.MeshError, match="not enough memory"):
        call()


@pytest.mark.parametrize("case", COMMANDS)
def test_commands_report_too_little_memory_and_write_nothing(
    monkeypatch: pytest.MonkeyPatch, meshes: tuple[Path, Path], case: str
) -> None:
    arguments, place = COMMANDS[case]
    monkeypatch.chdir(meshes[0].parent)
    add_colors(meshes[0])
    (meshes[0].parent / "map.npz").write_bytes(b"the former map")
    before = contents(meshes[0].parent)
    without_memory(monkeypatch, place)
    assert_refused(run(main, *arguments), NO_MEMORY)
    assert contents(meshes[0].parent) == before


@pytest.mark.parametrize("command", ["match", "symmetry", "transfer"])
def test_match_exceeding_memory_is_refused_with_a_remedy(
    monkeypatch: pytest.MonkeyPatch, meshes: tuple[Path, Path], command: str
) -> None:
    add_colors(meshes[0])
    source, target = map(str, meshes)
    output = str(meshes[0].parent / ("out.ply" if command == "transfer" else "map.npz"))
    full = memory_need.memory_need([400, 400], 200, None)
    monkeypatch.setattr(memory_need, "free_memory", lambda: full // 2)
    monkeypatch.setattr(memory_need, "CONSTANT", 0)
    monkeypatch.setattr(memory_need, "PER_VALUE", 100 * memory_need.PER_VALUE)
    arguments = [command, source, *([] if command == "symmetry" else [target])]
    ran = run(main, *arguments, "--detail", "full", "-o", output)
    assert ran.exit_code == 1
    assert "of memory, but only " in ran.output
    assert "simplify them to" in ran.output
    assert not Path(output).exists()


def test_command_start_reports_too_little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(**_: object) -> None:
        raise MemoryError

    modules = {"zoomout_core.cli": SimpleNamespace(main=SimpleNamespace(main=failing))}
    monkeypatch.setattr(entry, "import_module", lambda name: modules.get(name) or import_module(name))
    with pytest.raises(SystemExit, match="Error: There is not enough memory"):
        entry.main()


@pytest.mark.skipif(sys.platform != "linux", reason="limits of the address space")
def test_a_limited_process_ends_with_a_sentence(meshes: tuple[Path, Path]) -> None:
    # Threads start from about 20 MB on; at 30 MB native code sometimes crashes without memory.
    code = f"""
import resource, zoomout_core.matching.pipeline, zoomout_core.cli
pages = int(open("/proc/self/statm").read().split()[0])
resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + (16 << 20),) * 2)
zoomout_core.cli.main(["match", {str(meshes[0])!r}, {str(meshes[1])!r}, "-o", {str(meshes[0].with_name("map.npz"))!r}])
"""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert ran.returncode == 1
    assert "Traceback" not in ran.stderr
    assert "memory" in ran.stderr
