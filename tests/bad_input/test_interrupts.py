# SPDX-License-Identifier: GPL-3.0-or-later
"""Ctrl-C at any time ends a command soon, with one line, exit code 130, and no partial files."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import creatures
import pytest
from creatures import creature

import zoomout_core

# Fractions of the time that the work takes without an interrupt.
MOMENTS = (0.05, 0.25, 0.6)
# Seconds within which an interrupted command ends on an idle machine.
SOON = 10
PLACES = str(Path(zoomout_core.__file__).parents[1]), str(Path(creatures.__file__).parent)
IN_BLENDER = """
import bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
import sys
from creatures import creature
import blender_addon.cli
for name in ("Source", "Target"):
    surface = creature(2000, seed=len(name)).surface
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(surface.vertices.tolist(), [], surface.triangles.tolist())
    bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, mesh))
bpy.context.view_layer.update()
print("begun", flush=True)
sys.exit(blender_addon.cli.main(["match", "--source", "Source", "--target", "Target", "--save", sys.argv[1]]))
"""

# A collection that says when it starts its workers.
WITH_WORKERS = """
import sys
import distributed
from zoomout_core.__main__ import main

class Announced(distributed.LocalCluster):
    def __init__(self, **options):
        print("begun", flush=True)
        super().__init__(**options)

if __name__ == "__main__":
    distributed.LocalCluster = Announced
    sys.argv[1:] = ["collection", *sys.argv[1:], "-o", "made", "--workers", "2", "--no-pictures"]
    main()
"""


def slowness() -> float:
    """How many seconds a second of computation takes at the present load of this machine, at least one."""
    before = os.times()
    subprocess.run([sys.executable, "-c", "sum(range(20_000_000))"], check=True)
    after = os.times()
    computed = after.children_user + after.children_system - before.children_user - before.children_system
    return max(1.0, (after.elapsed - before.elapsed) / computed)


def interrupted(command: list[str], seconds: float, folder: Path, begun: bool = False) -> tuple[int, str]:
    """The exit code and the output of a command that is interrupted after some time."""
    process = subprocess.Popen(
        command,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(PLACES), "ZOOMOUT_CACHE": "off"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # ignored where tests run in the background
    )
    if begun:
        assert process.stdout is not None
        while "begun" not in (line := process.stdout.readline()):
            assert line, process.stderr and process.stderr.read()
    time.sleep(seconds)
    os.killpg(process.pid, signal.SIGINT)  # a terminal interrupts child processes, too
    start, slow = time.monotonic(), slowness()
    try:
        _, said = process.communicate(timeout=SOON * slow + 20)
    finally:
        process.kill()
    assert time.monotonic() - start < SOON * max(slow, slowness())
    return process.returncode, said


def check(command: list[str], seconds: float, output: Path, begun: bool = False) -> None:
    """Check that a command that is interrupted after some time ends with one line, unless it has ended before."""
    code, said = interrupted(command, seconds, output.parent, begun)
    assert "Traceback" not in said, said
    if code == 0 and output.exists():
        return
    # Interrupted within an import of a compiled module, Python ends by the signal itself, which shells call 130, too.
    assert code in (130, -signal.SIGINT), said
    assert [line for line in said.splitlines() if "interrupted" in line] == said.splitlines()[-1:]
    assert not [path for path in output.parent.iterdir() if path.name.startswith(output.name)]


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    """Two meshes that take seconds to match, the first with colours."""
    import trimesh

    paths = tmp_path / "source.ply", tmp_path / "target.ply"
    for seed, path in enumerate(paths):
        surface = creature(3000, seed=seed).surface
        made = trimesh.Trimesh(surface.vertices, surface.triangles, process=False)
        made.visual.vertex_colors = [[seed, 2, 3, 255]] * 3000
        made.export(path)
    return paths


@pytest.mark.slow(but=1)
@pytest.mark.skipif(sys.platform == "win32", reason="signals are others there")
@pytest.mark.parametrize("moment", MOMENTS)
def test_interrupted_commands_end_with_one_line(moment: float, pair: tuple[Path, Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    zoomout = [sys.executable, "-m", "zoomout_core", "match", *map(str, pair), "-o", str(out / "map.npz")]
    meshlab = [sys.executable, "-m", "meshlab_filter", "transfer", *map(str, pair), "-o", str(out / "made.ply")]
    check(zoomout, 0.05 + 3 * moment, out / "map.npz")
    check(meshlab, 0.05 + 4 * moment, out / "made.ply")


@pytest.mark.slow(but=1)
@pytest.mark.skipif(sys.platform == "win32", reason="signals are others there")
@pytest.mark.parametrize("seconds", [0.3, 0, 1, 2])
def test_interrupted_start_of_workers_ends_with_one_line(
    seconds: float, pair: tuple[Path, Path], tmp_path: Path
) -> None:
    pytest.importorskip("distributed")
    code, said = interrupted([sys.executable, "-c", WITH_WORKERS, *map(str, pair)], seconds, tmp_path, begun=True)
    assert code == 130, said
    assert said.splitlines()[-1:] == ["zoomout: interrupted; incomplete files were not written."]
    assert "Traceback" not in said, said


@pytest.mark.slow(but=1)
@pytest.mark.skipif(sys.platform == "win32", reason="signals are others there")
@pytest.mark.parametrize("moment", MOMENTS[:2])
def test_interrupted_blender_command_ends_with_one_line(moment: float, tmp_path: Path) -> None:
    pytest.importorskip("bpy")
    command = [sys.executable, "-c", IN_BLENDER, str(tmp_path / "saved.blend")]
    check(command, 2 * moment, tmp_path / "saved.blend", begun=True)
