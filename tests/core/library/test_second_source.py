# SPDX-License-Identifier: GPL-3.0-or-later
"""A search proposes another source for a part of the target that it fits much better."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from skinned_tubes import LENGTH, write_tube

import zoomout_core as zo
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.library.parts import PARTS, _pieces, find_part
from zoomout_core.mesh.surface import Surface
from zoomout_core.tuning import retune


def swollen(surface: Surface, amount: float) -> Surface:
    """The tube with a ring around the middle of its upper half."""
    points = surface.vertices.copy()
    bump = np.exp(-(((points[:, 1] / LENGTH - 0.75) / 0.1) ** 2))
    points[:, [0, 2]] *= 1 + amount * bump[:, None]
    return surface.with_vertices(points)


def found(path: Path, source: Surface, target: Surface, misfit: float) -> zo.FoundSource:
    """A source whose body is matched to another vertex by vertex, but every fifth one slides along it."""
    vertex = np.arange(len(source.vertices))
    vertex[1::5] -= 1
    slid = zo.SurfaceMap.from_vertices(vertex, source)
    match: Any = SimpleNamespace(source=source, target=target, surface_map=slid)
    return zo.FoundSource(path, 0.4, 0.97, misfit, match)


@pytest.fixture
def tube(tmp_path: Path) -> Surface:
    """A library file with the joints Lower and Upper."""
    write_tube(tmp_path / "body.glb")
    return read_asset(tmp_path / "body.glb").surface


def test_a_source_that_fits_a_part_much_better_is_proposed_for_it(tmp_path: Path, tube: Surface) -> None:
    body, head = tmp_path / "body.glb", tmp_path / "head.glb"
    # The target is elsewhere, in another unit; sources differ in the upper half.
    target = swollen(tube, 0.6)
    target = target.with_vertices(7 * target.vertices[:, [2, 0, 1]] + 3)
    best, other = found(body, tube, target, 0.05), found(head, swollen(tube, 0.55), target, 0.06)
    with retune(PARTS, max_share=0.7):
        part = find_part([best, other])
        assert part is not None
        assert (part.path, part.best, part.joint, part.joints) == (head, body, "Upper", ("Upper",))
        assert part.fit_of_best < 0.96 < 0.98 < part.fit
        assert str(part.sentence).startswith(f"{head} fits the joint Upper and all below it better than {body}")
        # None is proposed that is hardly better, that does not fit as a whole, or where the best one fits well.
        assert find_part([best, found(head, swollen(tube, 0.2), target, 0.06)]) is None
        assert find_part([best, found(head, swollen(tube, 0.55), target, 0.5)]) is None
        assert find_part([found(body, swollen(tube, 0.56), target, 0.05), other]) is None
        with retune(PARTS, poor=1.0):
            assert find_part([best, other]) is None
        with retune(PARTS, min_share=0.65):
            assert find_part([best, other]) is None
    assert find_part([best, other]) is None


def test_parts_are_those_of_joints(tmp_path: Path, tube: Surface) -> None:
    bare = tmp_path / "bare.glb"
    write_asset(zo.Asset(tube), bare)
    target = swollen(tube, 0.6)
    with retune(PARTS, max_share=0.7):
        for path in (bare, tmp_path / "missing.ply"):
            assert find_part([found(path, tube, target, 0.05), found(bare, target, target, 0.06)]) is None
    assert find_part([]) is None


def test_joints_that_move_few_vertices_belong_to_the_piece_above() -> None:
    joint = np.repeat([0, 1, 2, 3], [30, 25, 5, 4])
    pieces = _pieces(joint, np.array([-1, 0, 1, 2]))
    assert pieces.tolist() == [0] * 30 + [1] * 34
