# SPDX-License-Identifier: GPL-3.0-or-later
"""Proximity maps clothes to nearby body parts with similar normals, and gives the rest no confidence."""

from __future__ import annotations

import numpy as np
import pytest
from clothes import Region, dress, jacket, shell, shirt, trousers
from reports import reports_of
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

import zoomout_core as zo
from zoomout_core.samples.creatures import at_rest
from zoomout_core.samples.grids import ring_faces
from zoomout_core.transfer import Attribute, Domain, Kind, transfer

pytestmark = pytest.mark.usefixtures("few_candidates")

# Centres of the bones' influence on the creature at rest.
BONES = np.array(
    [[0, 0, 0], [0.8, 0.1, 0.35], [1.6, 0.1, 0.5], [0.3, 0, -0.9], [0.6, 0, -1.8], [0, 0, 1.2], [0, 1, -0.2]]
)
BONES = np.unique(np.concatenate([BONES, BONES * [-1, 1, 1]]), axis=0)


def skin_weights(rest: np.ndarray) -> np.ndarray:
    """(n, bones) smooth weights at places (n, 3) at rest; rows sum to one."""
    weights = np.exp(-((np.linalg.norm(rest[:, None] - BONES, axis=2) / 0.45) ** 2)) + 1e-9
    return weights / weights.sum(axis=1, keepdims=True)


def wearing(region: Region, offset: float, bend: float) -> tuple[zo.Surface, np.ndarray, zo.Surface, np.ndarray]:
    """A body and a garment on it in one pose, with the true weights of each."""
    both = dress([shell("garment", region, offset, 1500, seed=3)], 4000, bend=bend)
    parts = []
    for name in ("skin", "garment"):
        first, last = both.parts[name][[0, -1]]
        triangles = both.surface.triangles
        own = triangles[(triangles[:, 0] >= first) & (triangles[:, 0] <= last)] - first
        parts += [
            zo.Surface(both.surface.vertices[first : last + 1], own),
            skin_weights(at_rest(both.keys[both.parts[name]])),
        ]
    return tuple(parts)


def weights_error(
    body: zo.Surface, weights: np.ndarray, garment: zo.Surface, truth: np.ndarray, **options: float
) -> np.ndarray:
    """(n,) sum of absolute weight errors per vertex."""
    result = zo.match_by_proximity(body, garment, **options)
    attribute = Attribute("skin", Domain.POINT, Kind.WEIGHT, csr_array(weights))
    return np.abs(transfer(attribute, result, body, garment, fill_below=0.5).values.toarray() - truth).sum(axis=1)


@pytest.mark.parametrize("bend", [0.0, 1.0])
@pytest.mark.parametrize("region", [shirt(), jacket, trousers])
def test_wide_clothes_get_better_weights_than_by_nearest_points(region: Region, bend: float) -> None:
    outfit = wearing(region, 0.2, bend)
    ours = weights_error(*outfit)
    nearest = weights_error(*outfit, max_distance=10, max_angle=180)
    assert ours.mean() < 0.9 * nearest.mean()
    assert np.quantile(ours, 0.99) < np.quantile(nearest, 0.99)


def test_tight_clothes_are_mapped_almost_completely() -> None:
    body, _, garment, _ = wearing(shirt(), 0.03, 1.0)
    result = zo.match_by_proximity(body, garment)
    assert result.confidence.mean() > 0.99
    alone = int((result.confidence == 0).sum())
    assert sum(int(note.split(" of ")[0]) for note in result.notes) == alone


def legs(radius: float, layers: tuple[float, ...] = ()) -> tuple[zo.Surface, np.ndarray]:
    """Two close upright tubes, and which vertices belong to the left one.

    Garment vertices between them may be nearer to the other leg. With layers, each tube has an inner and an outer
    surface, joined at the hems.
    """
    around, rows = 48, 20
    turn, height = np.meshgrid(np.linspace(0, 2 * np.pi, around, endpoint=False), np.linspace(0, 4, rows))
    profile = [(r, h) for r, h in zip(np.full(rows, radius), height[:, 0], strict=True)]
    profile += [(r, h) for r in layers for h in height[::-1, 0]]
    ring = np.stack([np.cos(turn[0]), np.sin(turn[0])], axis=1)
    points = np.concatenate([np.column_stack([r * ring, np.full(around, h)]) for r, h in profile])
    quads = ring_faces(len(profile), around, closed=bool(layers))
    sides = [points + np.array([x, 0, 0]) for x in (1.1, -1.1)]
    surface = zo.Surface(np.concatenate(sides), np.concatenate([quads, quads + len(points)]))
    return surface, np.arange(2 * len(points)) < len(points)


def left_leg_weights(surface: zo.Surface, left: np.ndarray, cloth: zo.Surface, **options: float | bool) -> np.ndarray:
    """(n,) weight of the left leg on the vertices of a cloth."""
    sides = Attribute("side", Domain.POINT, Kind.WEIGHT, csr_array(np.stack([left, ~left], axis=1).astype(float)))
    result = zo.match_by_proximity(surface, cloth, **options)
    return transfer(sides, result, surface, cloth, fill_below=0.5).values.toarray()[:, 0]


@pytest.mark.parametrize("inside_out", [False, True])
def test_trousers_between_the_thighs_belong_to_their_own_leg(inside_out: bool) -> None:
    body, left = legs(1.0)
    cloth, of_left = legs(1.17)
    if inside_out:  # open cloth may be wound either way
        cloth = zo.Surface(cloth.vertices, cloth.corner_vertex.reshape(-1, 4)[:, ::-1])
    alone = left_leg_weights(body, left, cloth, max_angle=180)
    assert (np.abs(alone - of_left) > 0.5).mean() > 0.02
    np.testing.assert_allclose(left_leg_weights(body, left, cloth), of_left, atol=1e-6)


def test_inner_side_of_thick_clothes_is_mapped_if_allowed() -> None:
    body, left = legs(1.0)
    cloth, of_left = legs(1.04, layers=(1.08,))
    strict, both = (zo.match_by_proximity(body, cloth, either_side=either) for either in (False, True))
    assert strict.confidence.mean() < 0.6
    assert both.confidence.mean() > 0.95
    np.testing.assert_allclose(left_leg_weights(body, left, cloth, either_side=True), of_left, atol=1e-6)


def revolve(profile: np.ndarray, around: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Points and faces of a surface of revolution: a profile (rows, 2) of distances from the axis and heights."""
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    points = np.stack([np.outer(profile[:, 0], wave(angle)) for wave in (np.cos, np.sin)], axis=2)
    points = np.dstack([points, np.repeat(profile[:, 1:], around, axis=1)]).reshape(-1, 3)
    return points, ring_faces(len(profile), around)


def arc(radius: float, first: float, last: float, rows: int = 16) -> np.ndarray:
    """(rows, 2) points on a circle about the origin, at angles from its lowest point."""
    angle = np.linspace(first, last, rows)
    return radius * np.column_stack([np.sin(angle), -np.cos(angle)])


BOWL = zo.Surface(*revolve(np.vstack([arc(1, 0.01, 1.5), arc(0.9, 1.5, 0.01)])))


@pytest.mark.parametrize("winding", [1, -1])
def test_cloth_in_a_bowl_is_oriented_like_the_bowl_but_not_a_ball(winding: int) -> None:
    cloth, faces = revolve(arc(0.87, 0.3, 1.0))
    cloth[cloth[:, 0] > 0.6, 0] -= 0.3  # moves a part too far away to be mapped
    ball, around = revolve(arc(0.1, 0.0, np.pi, 9))
    ball[:, 2] -= 0.78
    both = np.vstack([[[np.nan] * 3], cloth, ball, [[0.0, 0, 9]]])
    result = zo.match_by_proximity(
        BOWL, zo.Surface(both, np.vstack([faces[:, ::winding] + 1, around + 1 + len(cloth)])), max_distance=0.05
    )
    of_cloth, of_ball = np.split(result.confidence[1:-1], [len(cloth)])
    lies = np.abs(np.linalg.norm(cloth, axis=1) - 0.87) < 1e-9
    assert of_cloth[lies].mean() > 0.9
    assert not of_ball[ball[:, 2] < -0.8].any()
    assert (result.confidence[[0, -1]] == 0).all()


@pytest.mark.parametrize("winding", [1, -1])
def test_outer_side_of_a_cloth_is_decided_by_area(winding: int) -> None:
    profile = np.vstack([arc(0.87, 0.3, 1.0, 6), arc(0.86, 0.99, 0.94, 14)])  # with a folded hem of many small faces
    cloth, faces = revolve(profile)
    confidence = zo.match_by_proximity(BOWL, zo.Surface(cloth, faces[:, ::winding])).confidence
    assert (confidence[: 4 * 40] == 1).all()
    assert (confidence[8 * 40 :] == 0).all()


def test_max_angle_applies_after_a_cloth_is_flipped() -> None:
    cloth, faces = revolve(arc(0.5, 0.2, 1.2, 30))
    lowered = cloth + np.array([0, 0, -0.37])
    outwards = lowered / np.linalg.norm(lowered, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.einsum("ij,ij->i", outwards, cloth / 0.5)))
    confidence = zo.match_by_proximity(BOWL, zo.Surface(lowered, faces), max_distance=1.0, max_angle=15).confidence
    clear = np.abs(angle - 15) > 3
    assert 0 < confidence[clear].mean() < 1
    np.testing.assert_array_equal(confidence[clear], angle[clear] < 15)


@pytest.mark.parametrize("angle", [0, 0.5, 180])
def test_smallest_and_largest_angle_are_accepted(angle: float) -> None:
    square = zo.Surface([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2, 3]])
    above = square.with_vertices(square.vertices + np.array([0, 0, 0.01]))
    assert zo.match_by_proximity(square, above, max_angle=angle).has_partner.all()


def test_progress_rises_and_does_not_change_the_result() -> None:
    body, _ = legs(1.0)
    cloth, _ = legs(1.04, layers=(1.08,))
    result, reports = reports_of(lambda: zo.match_by_proximity(body, cloth))
    fractions = [report.fraction for report in reports]
    assert fractions == sorted(fractions)
    assert 0 <= fractions[0] <= fractions[-1] <= 1
    assert {report.stage for report in reports} == {"Finding the nearest points"}
    np.testing.assert_array_equal(result.confidence, zo.match_by_proximity(body, cloth).confidence)


def test_distant_vertices_are_reported_without_confidence() -> None:
    body, _ = legs(1.0)
    cloth, _ = legs(1.04)
    high = cloth.vertices[:, 2] > 2
    moved = zo.Surface(cloth.vertices + np.where(high, 9, 0)[:, None] * [0, 1, 0], cloth.corner_vertex.reshape(-1, 4))
    result = zo.match_by_proximity(body, moved)
    assert (result.confidence[high] == 0).all()
    assert result.confidence[~high].mean() > 0.9
    assert not result.has_partner[high].any()
    assert result.has_partner[~high].mean() > 0.9
    assert (
        f"{high.sum():,} of {len(high):,} vertices have no partner on the source: the nearest point is too far away."
        in (result.notes)
    )


def test_units_placement_and_numbering_do_not_matter() -> None:
    body, _, garment, _ = wearing(shirt(), 0.2, 1.0)
    once = zo.match_by_proximity(body, garment).confidence
    turn = Rotation.from_rotvec([1, 2, 3])

    def moved(surface: zo.Surface) -> np.ndarray:
        return 1000 * turn.apply(surface.vertices) + 5

    order = np.random.default_rng(0).permutation(len(garment.vertices))
    other = zo.Surface(moved(garment)[order], np.argsort(order)[garment.triangles])
    again = zo.match_by_proximity(zo.Surface(moved(body), body.triangles), other).confidence
    assert (again != once[order]).sum() <= 1


def test_unused_vertices_are_mapped_without_confidence() -> None:
    body, _ = legs(1.0)
    cloth, _ = legs(1.04)
    stray = np.concatenate([cloth.vertices, [[np.nan] * 3, [1.1, 0, 5]]])
    result = zo.match_by_proximity(body, zo.Surface(stray, cloth.corner_vertex.reshape(-1, 4)))
    np.testing.assert_array_equal(result.confidence[-2:], 0)
    assert np.isfinite(result.surface_map.barycentric).all()


def test_invalid_thresholds_and_distant_clothes_are_refused() -> None:
    body, _ = legs(1.0)
    for distance in (0, -1, np.nan, np.inf):
        with pytest.raises(ValueError, match="max_distance is"):
            zo.match_by_proximity(body, body, max_distance=distance)
    for angle in (-1, 181, np.nan):
        with pytest.raises(ValueError, match="max_angle is"):
            zo.match_by_proximity(body, body, max_angle=angle)
    away = zo.Surface(body.vertices + 100, body.corner_vertex.reshape(-1, 4))
    with pytest.raises(zo.MeshError, match="No part of the target is near the source"):
        zo.match_by_proximity(body, away)
