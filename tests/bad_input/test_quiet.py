# SPDX-License-Identifier: GPL-3.0-or-later
"""With --quiet, commands print errors alone, and JSON where it is asked for."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from interfaces import add_colors, run

from zoomout_core.cli import main as zoomout

FAST = ("--detail", "fast")


def arguments(name: str, meshes: tuple[Path, Path], folder: Path) -> tuple[str | Path, ...]:
    start = (*FAST, "--initial", "proximity", "--force")
    return {
        "match": ("match", *meshes, "-o", folder / "map.npz", *start[:-1]),
        "nearest": ("match", *meshes, "-o", folder / "map.npz", "--initial", "nearest"),
        "transfer": ("transfer", *meshes, "-o", folder / "out.ply", *start),
        "transfer to a folder": ("transfer", *meshes, "-o", folder / "out", *start),
        "symmetry": ("symmetry", meshes[0], "-o", folder / "map.npz", *FAST),
        "collection": ("collection", *meshes, "-o", folder / "all", "--workers", "1", "--no-pictures", *FAST),
        "info": ("info", meshes[0]),
        "sample": ("sample", folder / "samples"),
    }[name]


NAMES = ("match", "nearest", "transfer", "transfer to a folder", "symmetry", "collection", "info", "sample")


@pytest.fixture
def colored(meshes: tuple[Path, Path]) -> tuple[Path, Path]:
    """The meshes, with colours to transfer."""
    for path in meshes:
        add_colors(path)
    return meshes


@pytest.mark.slow(but=2)
@pytest.mark.parametrize("name", NAMES)
def test_quiet_prints_nothing_except_json(name: str, colored: tuple[Path, Path], tmp_path: Path) -> None:
    given = arguments(name, colored, tmp_path)
    ran = run(zoomout, *given, "--quiet")
    assert (ran.exit_code, ran.output) == (0, "")
    (tmp_path / "again").mkdir()
    again = arguments(name, colored, tmp_path / "again")
    ran = run(zoomout, "-q", *again, "--json")
    assert ran.exit_code == 0
    assert json.loads(ran.output)


@pytest.mark.parametrize("name", ["match", "transfer", "symmetry", "collection", "info"])
def test_quiet_prints_errors(name: str, tmp_path: Path) -> None:
    missing = tmp_path / "none.ply", tmp_path / "nothing.ply"
    ran = run(zoomout, "--quiet", *arguments(name, missing, tmp_path))
    assert ran.exit_code == 1
    (line,) = ran.output.splitlines()
    assert line.startswith("Error: There is no file")


def test_help_lists_nearest_only_for_match() -> None:
    assert "proximity, nearest, or" in " ".join(run(zoomout, "match", "--help").output.split())
    assert "proximity, or" in " ".join(run(zoomout, "transfer", "--help").output.split())


def test_invalid_initial_lists_allowed_starts(meshes: tuple[Path, Path], tmp_path: Path) -> None:
    ran = run(zoomout, "match", *meshes, "-o", tmp_path / "map.npz", "--initial", "neares")
    assert "--initial is 'neares': give auto, landmarks, proximity, nearest, or the file" in ran.output


def test_nearest_start_of_other_commands_names_the_way(meshes: tuple[Path, Path], tmp_path: Path) -> None:
    ran = run(zoomout, "transfer", *meshes, "-o", tmp_path / "out.ply", "--initial", "nearest")
    assert ran.exit_code == 2
    assert (
        "--initial nearest is a start of `zoomout match` alone: run that, and give its map as --initial." in ran.output
    )


@pytest.mark.parametrize(
    ("option", "said"),
    [
        (("--max-distance", "1"), "--max-distance has an effect only with --initial nearest"),
        (("--either-side",), "--either-side has an effect only with --initial nearest"),
        (("--most-distance", "1"), "Did you mean '--max-distance'"),
        (("--most-angle", "1"), "'--max-angle'"),
    ],
)
def test_options_of_the_nearest_start_are_explained(
    option: tuple[str, ...], said: str, meshes: tuple[Path, Path], tmp_path: Path
) -> None:
    ran = run(zoomout, "match", *meshes, "-o", tmp_path / "map.npz", *option)
    assert ran.exit_code == 2
    assert said in ran.output
