# SPDX-License-Identifier: GPL-3.0-or-later
"""A limb that a map turns is placed by its shape; the rest of the map stays."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from creatures import LIMBS, creature, true_vertex
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import zoomout_core as zo
from zoomout_core.arrays import Booleans, Floats
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.pair import Pair
from zoomout_core.matching.preparation.analysis import ShapeAnalysis, analyse
from zoomout_core.matching.ranking.candidate import Candidate
from zoomout_core.matching.refinement.confidence import local_distortion
from zoomout_core.matching.refinement.dense_map import dense_map
from zoomout_core.matching.refinement.distorted_regions import (
    REGIONS,
    Placement,
    find_placements,
    move_regions,
    move_regions_back,
)
from zoomout_core.matching.refinement.refine import final_size, functional_map_by
from zoomout_core.tuning import retune

LEG = LIMBS[2] / np.linalg.norm(LIMBS[2])
# Cosine of the angle around the leg within which the map is turned.
REACH = 0.85
TURN = 80.0  # degrees


@cache
def shapes() -> tuple[ShapeAnalysis, ShapeAnalysis]:
    """The shapes of two meshes of one creature."""
    source, target = (analyse(creature(2000, seed).surface.working.part(0)[0], 60, 500, 0, None) for seed in (0, 1))
    return source, target


def true_map(source: int, target: int) -> SurfaceMap:
    """The map of one mesh of the creature to the other, by the numbers of both."""
    made = creature(2000, source), creature(2000, target)
    found = SurfaceMap.from_vertices(true_vertex(*made), made[0].surface)
    return SurfaceMap(found.triangle, found.barycentric, shapes()[source].mesh.triangles)


def leg() -> Booleans:
    """(n_t,) the target's vertices on the leg."""
    return np.asarray(creature(2000, 1).directions @ LEG > REACH)


def turned_map(degrees: float = TURN) -> SurfaceMap:
    """The map of the target's mesh, which maps the leg as if it were turned across its axis."""
    source = shapes()[0]
    vertex = true_map(0, 1).vertex.copy()
    places = source.mesh.vertices[vertex[leg()]]
    across = np.cross(LEG, [0.3, 0.5, 0.8])
    turn = Rotation.from_rotvec(np.radians(degrees) * across / np.linalg.norm(across)).as_matrix()
    vertex[leg()] = cKDTree(source.mesh.vertices).query((places - places.mean(axis=0)) @ turn.T + places.mean(axis=0))[
        1
    ]
    found = SurfaceMap.from_vertices(vertex, creature(2000, 0).surface)
    return SurfaceMap(found.triangle, found.barycentric, source.mesh.triangles)


def placements(first: SurfaceMap) -> list[Placement]:
    """The new poses of the regions that a map distorts."""
    return find_placements(first, local_distortion(first, *shapes(), mirrored=False), *shapes(), mirrored=False)


def errors(surface_map: SurfaceMap) -> Floats:
    """(n_t,) distances of images from the true ones, at unit area."""
    vertices = shapes()[0].mesh.vertices
    return np.linalg.norm(surface_map.interpolate(vertices) - true_map(0, 1).interpolate(vertices), axis=1)


@pytest.mark.parametrize("degrees", [TURN, 130.0, 160.0])
def test_turned_limb_is_placed_by_its_shape(degrees: float) -> None:
    # Larger turns need starting poses at all angles, and the normals.
    turned = turned_map(degrees)
    found = placements(turned)
    assert len(found) == 1
    moved = move_regions(turned, found, *shapes(), mirrored=False)
    assert errors(moved)[leg()].mean() < 0.5 * errors(turned)[leg()].mean()
    kept = np.setdiff1d(np.arange(len(leg())), found[0].region)
    np.testing.assert_array_equal(moved.vertex[kept], turned.vertex[kept])


def test_map_back_follows_the_placement() -> None:
    found, target = placements(turned_map()), shapes()[1]
    lost = SurfaceMap.from_vertices(np.zeros(2000, dtype=int), creature(2000, 1).surface)
    back = move_regions_back(
        SurfaceMap(lost.triangle, lost.barycentric, target.mesh.triangles), found, *shapes(), mirrored=False
    )
    off = np.linalg.norm(
        (back.interpolate(target.mesh.vertices) - true_map(1, 0).interpolate(target.mesh.vertices))[found[0].partners],
        axis=1,
    )
    assert off.mean() < 0.1


def test_map_without_distorted_regions_is_kept() -> None:
    assert placements(true_map(0, 1)) == []


def test_region_whose_pose_fits_is_kept() -> None:
    # All of the leg counts as distorted, but no pose fits better than that of the map.
    distortion = leg().astype(float)
    assert find_placements(true_map(0, 1), distortion, *shapes(), mirrored=False) == []


@pytest.mark.parametrize(
    "limits",
    [{"min_area": 0.25}, {"max_area": 0.06}, {"min_width": 0.98}, {"min_kept": 1.0}],
    ids=["small", "large", "slender", "moved away"],
)
def test_unreliable_region_is_kept(limits: dict[str, float]) -> None:
    with retune(REGIONS, **limits):
        assert placements(turned_map()) == []


def test_mirrored_map_is_placed_in_the_mirror_image() -> None:
    source, target = shapes()
    mirrored = replace_mesh_by_mirror_image(target)
    turned = turned_map()
    distortion = local_distortion(turned, source, mirrored, mirrored=True)
    found = find_placements(turned, distortion, source, mirrored, mirrored=True)
    moved = move_regions(turned, found, source, mirrored, mirrored=True)
    assert errors(moved)[found[0].region].mean() < 0.4 * errors(turned)[found[0].region].mean()


def replace_mesh_by_mirror_image(shape: ShapeAnalysis) -> ShapeAnalysis:
    """The analysis of the mirror image, whose triangles still face outwards."""
    made = creature(2000, 1).surface
    surface = zo.Surface(made.vertices * [-1, 1, 1], made.triangles[:, ::-1])
    mirrored = analyse(surface.working.part(0)[0], 60, 500, 0, None)
    np.testing.assert_allclose(mirrored.mesh.vertices * [-1, 1, 1], shape.mesh.vertices, atol=1e-6)
    return mirrored


@cache
def matched() -> tuple[Pair, Candidate]:
    """The pair of the two meshes, and its first candidate, whose finished map turns the leg."""
    result = zo.match(*(creature(2000, seed).surface for seed in (0, 1)), k_final=60)
    pair, first = result.pair, result.candidates[0]
    size = final_size(pair.source_shape, pair.target_shape, pair.k_final)
    turned = turned_map()
    refined = turned, functional_map_by(turned, pair.source_shape, pair.target_shape, (size, size))
    return pair, replace(first, refined=refined, distortion=None)


def test_finished_map_has_the_limb_in_place() -> None:
    pair, candidate = matched()
    with retune(REGIONS, min_area=1):
        turned = errors(dense_map(pair, candidate).fit.surface_map)[leg()].mean()
    assert errors(dense_map(pair, candidate).fit.surface_map)[leg()].mean() < 0.5 * turned


@pytest.mark.parametrize("kept", [True, False])
def test_regions_stay_where_landmarks_hold_the_map(kept: bool) -> None:
    pair, candidate = matched()
    constrained = replace(candidate, final_anchors=candidate.anchors) if kept else candidate
    assert candidate.anchors is not None
    off = errors(dense_map(pair, constrained).fit.surface_map)[leg()].mean()
    assert (off > 0.5 * errors(turned_map())[leg()].mean()) == kept
