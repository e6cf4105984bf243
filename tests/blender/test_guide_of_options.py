# SPDX-License-Identifier: GPL-3.0-or-later
"""As CONTRIBUTING.md says, one row of the table is an option of every entry point, and on their page."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from guide import ROOT, follow

# Each interface is given a step of 7, which has to reach `match`.
SCRIPT = """
import sys

sys.path.append({tools!r})

import bpy
import meshlab_filter
import option_page
import pymeshlab
import trimesh
from click.testing import CliRunner

import blender_addon
import zoomout_core as zo
from zoomout_core.cli import main, match_command

steps = []

def match(source, target, **options):
    steps.append(options["step"])
    raise zo.MeshError("Enough.")

zo.match = match_command.match_shapes = match

trimesh.creation.icosphere().export("ball.ply")
assert "Enough." in CliRunner().invoke(main, ["match", "ball.ply", "ball.ply", "-o", "map.npz", "--step", "7"]).output
assert "--step" in CliRunner().invoke(main, ["transfer", "--help"]).output

meshes = pymeshlab.MeshSet()
meshes.create_sphere()
meshes.create_sphere()
try:
    meshlab_filter.compute_correspondence_by_zoomout(meshes, sourcemesh=0, targetmesh=1, step=7)
except zo.MeshError:
    pass

bpy.ops.wm.read_factory_settings(use_empty=True)
with blender_addon.registered():
    for place in (0, 3):
        bpy.ops.mesh.primitive_monkey_add(location=(place, 0, 0))
    bpy.ops.object.select_all(action="SELECT")
    bpy.context.scene.zoomout.step = 7
    try:
        bpy.ops.zoomout.match()
    except RuntimeError:
        pass

assert steps == [7, 7, 7], steps
assert "`--step` | *Step* | `step` | whole number; default 20 |" in option_page.tables()
"""


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the packages with one more row in the table."""
    folder = tmp_path_factory.mktemp("copy")
    follow("An option of a match", folder)
    return folder


@pytest.mark.slow
def test_one_table_row_adds_an_option_to_every_interface(copy: Path):
    environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1", "ZOOMOUT_CACHE": "off"}
    script = SCRIPT.format(tools=str(ROOT / "tools"))
    done = subprocess.run([sys.executable, "-c", script], env=environment, cwd=copy, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr + done.stdout
