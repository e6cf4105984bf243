"""The command `zoomout` does its job from files, and says in a sentence what it cannot do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner, Result
from creatures import Creature, mirrored_vertex, true_vertex

import zoomout_core as zo
from zoomout_core.cli import main


@pytest.fixture(scope="module")
def files(resting: Creature, bent: Creature, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("meshes")
    for name, creature in (("source", resting), ("target", bent)):
        mesh = trimesh.Trimesh(creature.surface.vertices, creature.surface.triangles, process=False)
        mesh.export(folder / f"{name}.ply")
    return folder


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def test_match_writes_the_whole_map_and_reports(files: Path, resting: Creature, bent: Creature) -> None:
    outcome = run("match", files / "source.ply", files / "target.ply", "-o", files / "map.npz")
    assert outcome.exit_code == 0, outcome.output
    assert "Mean confidence" in outcome.output
    with np.load(files / "map.npz") as file:
        assert set(file.files) == {"triangle", "barycentric", "vertex", "confidence", "functional_map"}
        error = zo.geodesic_error(
            file["vertex"], resting.surface, np.arange(len(bent.directions)), true_vertex(resting, bent)
        )
    assert error.mean() < 0.03


def test_landmarks_and_an_earlier_map_are_ways_to_begin(files: Path, resting: Creature, bent: Creature) -> None:
    tips = np.array([bent.directions @ axis for axis in ([1, 0.1, 0.35], [-1, 0.1, 0.35], [0, 1, -0.25])]).argmax(1)
    pairs = np.column_stack([mirrored_vertex(resting, bent)[tips], tips])
    np.savetxt(files / "pairs.txt", pairs, fmt="%d")
    meshes = files / "source.ply", files / "target.ply"
    outcome = run("match", *meshes, "-o", files / "turned.npz", "--landmarks", files / "pairs.txt")
    assert outcome.exit_code == 0, outcome.output
    outcome = run("match", *meshes, "-o", files / "again.npz", "--initial", files / "turned.npz")
    assert outcome.exit_code == 0, outcome.output
    turned, again = (zo.SurfaceMap.load(files / f"{name}.npz", resting.surface) for name in ("turned", "again"))
    places = [surface_map.interpolate(resting.surface.vertices)[tips] for surface_map in (turned, again)]
    for found in places:
        distance = np.linalg.norm(found - resting.surface.vertices[pairs[:, 0]], axis=1)
        assert (distance / np.sqrt(resting.surface.area) < 0.3).all()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("nothing.ply", "target.ply"), "nothing.ply"),
        (("source.ply", "target.ply", "--initial", "magic"), "magic"),
        (("source.ply", "broken.ply"), "broken.ply"),
        (("source.ply", "target.ply", "--initial", "broken.ply"), "holds no map"),
        (("source.ply", "target.ply", "--landmarks", "broken.ply"), "vertex numbers"),
        (("source.ply", "target.ply", "--landmarks", "empty.ply"), "vertex numbers"),
        (("source.ply", "target.ply", "--landmarks", "fractions.ply"), "vertex numbers"),
        (("source.ply", "target.ply", "--landmarks", "triples.ply"), "vertex numbers"),
        (("source.ply", "target.ply", "--initial", "landmarks"), "--landmarks FILE"),
        (("source.ply", "target.ply", "-o", "map"), "does not end in .npz"),
    ],
)
@pytest.mark.filterwarnings("error")
def test_what_cannot_be_done_is_said_in_one_sentence(files: Path, arguments: tuple[str, ...], sentence: str) -> None:
    for name, text in {
        "broken": "ply\nthis is no mesh\n",
        "empty": "",
        "fractions": "0.5 1\n",
        "triples": "0 1 2\n",
    }.items():
        (files / f"{name}.ply").write_text(text)
    named = [files / name if name.endswith(".ply") else name for name in arguments]
    outcome = run("match", "-o", files / "none.npz", *named)
    assert outcome.exit_code != 0
    assert outcome.output.startswith("Error: ")
    assert outcome.output.strip().count("\n") == 0
    assert sentence in outcome.output
    assert not (files / "none.npz").exists()
