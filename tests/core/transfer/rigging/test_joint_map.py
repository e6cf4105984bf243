# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps of bodies by the joints of their rigs, on mannequins."""

from __future__ import annotations

import numpy as np
import pytest
from mannequins import STEP, Mannequin, mannequin
from rigged_mannequins import rigged

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.transfer.rigging.joint_map import SharedJoints

TALL = (0.8, 1.1, 1.3)


def bodies() -> tuple[Mannequin, Mannequin, SharedJoints]:
    """A mannequin, a posed one of another build and mesh, and their joints."""
    source, target = mannequin(), mannequin(STEP, seed=3, build=TALL)
    found = SharedJoints.of(rigged(source, source), rigged(target, mannequin(seed=3, build=TALL), TALL))
    assert found is not None
    return source, target, found


def test_places_of_another_pose_and_build_are_found() -> None:
    source, target, joints = bodies()
    found = joints.map()
    image = found.vertex
    # Ellipsoids overlap, so that some places belong to two parts.
    assert (source.part[image] == target.part).mean() > 0.9
    off = np.linalg.norm(found.interpolate(source.keys) - target.keys, axis=1)
    assert np.median(off[source.part[image] == target.part]) < 0.03
    assert joints.share_on_other_limbs(found) < 0.01


def test_joints_contradict_a_map_that_confuses_legs() -> None:
    source, target, joints = bodies()
    right = joints.map()
    assert not joints.contradict(right)
    vertex = right.vertex.copy()
    for part in ("thigh", "shin", "foot"):
        vertex[target.part == f"{part}.L"] = np.flatnonzero(source.part == f"{part}.R")[0]
    wrong = SurfaceMap.from_vertices(vertex, source.surface)
    assert joints.contradict(wrong)
    assert 0.1 < joints.share_on_other_limbs(wrong) < 0.3


@pytest.mark.parametrize(
    ("of_joints", "of_map", "contradicts"),
    [(0.05, 0.3, True), (0.1, 0.3, False), (0.001, 0.02, False)],
)
def test_joints_contradict_only_maps_with_much_more_on_other_limbs(
    monkeypatch: pytest.MonkeyPatch, of_joints: float, of_map: float, contradicts: bool
) -> None:
    _, _, joints = bodies()
    given = joints.map()

    def share(_: SharedJoints, surface_map: SurfaceMap) -> float:
        return of_map if surface_map is given else of_joints

    monkeypatch.setattr(SharedJoints, "share_on_other_limbs", share)
    assert joints.contradict(given) == contradicts


def test_unknown_rigs_share_no_joints() -> None:
    body = mannequin()
    rig = rigged(body, body)
    unknown = rig._replace(bones=rig.bones._replace(humanoid={}))
    assert SharedJoints.of(rig, unknown) is None
