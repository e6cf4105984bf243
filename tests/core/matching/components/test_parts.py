# SPDX-License-Identifier: GPL-3.0-or-later
"""Loose parts find their partners, bend with the body, and are reported where they have none."""

from __future__ import annotations

import numpy as np
import pytest
from clothes import (
    Clothed,
    Piece,
    ball,
    bodice,
    dress,
    shell,
    shirt,
    skin_normals,
    sleeve,
    trousers,
    true_vertices,
)
from creatures import creature, directions, true_vertex
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import zoomout_core as zo
from zoomout_core.matching.components.boundary_loops import loops_on_loops
from zoomout_core.matching.components.main_parts import main_parts
from zoomout_core.matching.components.parts import Part, pair_parts
from zoomout_core.matching.components.similarity_field import SimilarityField
from zoomout_core.mesh.surface import Surface
from zoomout_core.samples.creatures import at_rest
from zoomout_core.samples.grids import ring_faces
from zoomout_core.spectral.sampling import farthest_points

pytestmark = pytest.mark.usefixtures("few_candidates")

EYES = {"eye.L": np.array([0.3, -0.5, 1.0]), "eye.R": np.array([-0.3, -0.5, 1.0])}
BUTTON, TOP = np.array([0, -1, 0.2]), np.array([0, 0.05, 1])


def eyes(seed: int) -> list[Piece]:
    return [ball(name, place, 0.06, 0.05, 80, seed + i) for i, (name, place) in enumerate(EYES.items())]


def in_pieces(seed: int) -> list[Piece]:
    """The shirt in three parts."""
    regions = {"sleeve.L": sleeve(1), "sleeve.R": sleeve(-1), "bodice": bodice}
    return [shell(name, region, 0.03, 300, seed + i) for i, (name, region) in enumerate(regions.items())]


def hair(count: int, seed: int) -> list[Piece]:
    """Upright strips of six triangles on the head."""
    where = directions(20 * count, seed)
    where = where[at_rest(where)[:, 2] > 1.0]
    where = where[farthest_points(at_rest(where), count)]
    across = np.cross(skin_normals(where), np.random.default_rng(seed).standard_normal(where.shape))
    across *= 0.03 / np.linalg.norm(across, axis=1, keepdims=True)
    corners = np.array([[0, 1, 2], [1, 3, 2]])
    strip = np.vstack([corners + 2 * i for i in range(3)])
    rows = [
        at_rest(where) + (0.02 + 0.06 * i) * skin_normals(where) + side * across for i in range(4) for side in (-1, 1)
    ]
    return [Piece(f"card {i}", points, strip, points) for i, points in enumerate(np.stack(rows, axis=1))]


def errors(result: zo.MatchResult, source: Clothed, target: Clothed, name: str, on: str | None = None) -> np.ndarray:
    """Distances of a part's images from the truth, relative to the square root of the area."""
    truth = source.surface.vertices[true_vertices(source, target, name, on)]
    images = result.surface_map.interpolate(source.surface.vertices)[target.parts[name]]
    return np.linalg.norm(images - truth, axis=1) / np.sqrt(source.surface.area)


Match = tuple[zo.MatchResult, Clothed, Clothed]


@pytest.fixture(scope="module")
def torn() -> Match:
    """A match whose target has the shirt in three pieces, a hat that the source lacks, and no button."""
    worn = [shell("shirt", shirt(), 0.03, 700, 21), shell("trousers", trousers, 0.03, 700, 22)]
    source = dress([*eyes(1), *worn, ball("button", BUTTON, 0.04, 0.1, 60, 9)], 2500, 0)
    worn = [*in_pieces(31), shell("trousers", trousers, 0.03, 600, 35)]
    target = dress([*eyes(5), *worn, ball("hat", TOP, 0.1, 0.4, 60, 8)], 2200, 1, 0.7)
    return zo.match(source.surface, target.surface), source, target


@pytest.fixture(scope="module")
def sewn() -> Match:
    """A match whose source has the shirt in pieces; both have too many strips of hair to pair."""
    buttons = [ball("button", BUTTON, 0.12, 0.1, 60, seed) for seed in (6, 7)]
    source = dress([*in_pieces(31), buttons[0], *hair(350, 1)], 2500, 0)
    target = dress([shell("shirt", shirt(), 0.03, 700, 21), buttons[1], *hair(400, 2)], 2200, 1, 0.5)
    return zo.match(source.surface, target.surface), source, target


@pytest.mark.slow
def test_clothes_bend_with_the_body_and_map_to_their_partners(torn: Match) -> None:
    result, source, target = torn
    assert errors(result, source, target, "trousers").mean() < 0.02
    assert (errors(result, source, target, "trousers") < 0.03).mean() > 0.9
    assert np.isin(result.surface_map.vertex[target.parts["trousers"]], source.parts["trousers"]).all()
    assert result.confidence[target.parts["trousers"]].mean() > 0.3


def test_left_and_right_eyes_keep_their_sides(torn: Match) -> None:
    result, source, target = torn
    for name in EYES:
        assert np.isin(result.surface_map.vertex[target.parts[name]], source.parts[name]).all()
        assert errors(result, source, target, name).mean() < 0.005
        assert (result.confidence[target.parts[name]] > 0.5).all()


def test_target_pieces_map_to_the_whole_source_part(torn: Match) -> None:
    result, source, target = torn
    for name in ("sleeve.L", "sleeve.R", "bodice"):
        assert np.isin(result.surface_map.vertex[target.parts[name]], source.parts["shirt"]).all()
        assert errors(result, source, target, name, "shirt").mean() < 0.025
        assert 0.1 < result.confidence[target.parts[name]].mean() < 0.8
    assert any(note.startswith("3 loose parts of the target mapped to other parts") for note in result.notes)


def test_parts_that_only_one_side_has_are_reported(torn: Match) -> None:
    result, source, target = torn
    hat = target.parts["hat"]
    assert (result.confidence[hat] == 0).all()
    assert np.isin(result.surface_map.vertex[hat], source.parts["skin"]).all()
    images = result.surface_map.interpolate(source.surface.vertices)
    top = source.surface.vertices[source.parts["skin"]][:, 2].max()
    assert images[hat][:, 2].min() > top - 0.7
    assert any(note.startswith("3 loose parts paired") for note in result.notes)
    assert any(note.startswith("1 loose part of the target without a partner") for note in result.notes)
    assert any(note.startswith("1 loose part of the source without a partner") for note in result.notes)


@pytest.mark.slow
def test_whole_target_part_maps_to_all_source_pieces(sewn: Match) -> None:
    result, source, target = sewn
    here, rest = target.parts["shirt"], target.keys[target.parts["shirt"]]
    image = result.surface_map.vertex[here]
    assert np.isin(image, np.concatenate([source.parts[name] for name in ("sleeve.L", "sleeve.R", "bodice")])).all()
    for side, name in ((1, "sleeve.L"), (-1, "sleeve.R")):
        far_out = side * at_rest(rest)[:, 0] > 1.4
        assert np.isin(image[far_out], source.parts[name]).mean() > 0.95
    assert np.isin(image[np.abs(at_rest(rest)[:, 0]) < 0.6], source.parts["bodice"]).mean() > 0.95


@pytest.mark.slow
def test_hair_beyond_the_limit_maps_to_nearby_hair(sewn: Match) -> None:
    result, source, target = sewn
    cards = np.concatenate([vertices for name, vertices in target.parts.items() if name.startswith("card")])
    theirs = np.concatenate([vertices for name, vertices in source.parts.items() if name.startswith("card")])
    on_hair = np.isin(result.surface_map.vertex[cards], theirs)
    assert on_hair.mean() > 0.9
    # The head does not bend, so hair corresponds to hair in the same place.
    images = result.surface_map.interpolate(source.surface.vertices)[cards]
    distance = np.linalg.norm(images - target.surface.vertices[cards], axis=1) / np.sqrt(source.surface.area)
    assert np.median(distance) < 0.02
    on_skin = np.isin(result.surface_map.vertex[cards], source.parts["skin"])
    np.testing.assert_array_equal(result.confidence[cards] == 0, on_skin)
    assert any(note.startswith("102 loose parts beyond the 300 largest") for note in result.notes)


@pytest.mark.slow
def test_a_cloak_larger_than_its_wearer_is_not_taken_for_the_body() -> None:
    source, body = creature(1500), creature(1200, seed=1, bend=0.4)
    u, v = (axis.ravel() for axis in np.meshgrid(np.linspace(-4, 4, 20), np.linspace(-4, 3, 20)))
    corner = (np.arange(19)[:, None] * 20 + np.arange(19)).ravel()[:, None]
    quads = np.hstack([corner, corner + 1, corner + 21, corner + 20]) + len(body.surface.vertices)
    cloak = np.column_stack([u, 2.5 + 0.4 * np.cos(u), v])
    triangles = np.vstack([body.surface.triangles, quads[:, :3], quads[:, [0, 2, 3]]])
    target = Surface(np.vstack([body.surface.vertices, cloak]), triangles)
    result = zo.match(source.surface, target)
    truth = true_vertex(source, body)
    assert zo.geodesic_error(result.surface_map, source.surface, np.arange(len(truth)), truth).mean() < 0.05
    assert (result.confidence[len(truth) :] < 0.05).all()


@pytest.mark.slow
def test_largest_parts_are_matched_by_default() -> None:
    """A suit has nearly the size and shape of its wearer."""
    whole = [shell("suit", lambda rest: rest[:, 2] < 1.3, 0.01, 800, seed) for seed in (3, 4)]
    source, target = dress(whole[:1], 1200, 0), dress(whole[1:], 1000, 1, 0.9)
    sizes = [surface.surface.working.part(0)[0].scale for surface in (source, target)]
    assert [part.scale for part in main_parts(source.surface, target.surface, 0)] == sizes


# --- single functions---------------------------------------------------------------------------------------


def part_of(surface: Surface, moved: np.ndarray | float = 0.0) -> Part:
    """A surface of one component as a part."""
    n = len(surface.working.vertices)
    points = surface.working.vertices * surface.working.scale + moved
    return Part(surface.working, np.arange(n), np.arange(len(surface.triangles)), points, np.full(n, 1 / n))


def sphere(radius: float) -> Surface:
    points = directions(80, 3)
    return Surface(radius * points, ConvexHull(points).simplices)


@pytest.mark.parametrize("mirror", [1, -1])
def test_surroundings_follow_a_rotated_or_mirrored_body_exactly(mirror: int) -> None:
    basis = zo.eigenbasis(creature(1000).surface, 60)
    places = creature(1000).surface.working.vertices
    linear = 0.7 * Rotation.from_rotvec([0.3, -1, 0.5]).as_matrix() * [mirror, 1, 1]
    motion = SimilarityField(places, places @ linear.T + [1, 2, 3], np.full(len(places), 0.4), basis)
    random = np.random.default_rng(0)
    points, normals = places[:200] + random.normal(scale=0.1, size=(200, 3)), random.standard_normal((200, 3))
    carried, turned, trust = motion.transform(points, normals)
    np.testing.assert_allclose(carried, points @ linear.T + [1, 2, 3], atol=1e-5)
    expected = normals @ linear.T
    np.testing.assert_allclose(turned, expected / np.linalg.norm(expected, axis=1, keepdims=True), atol=1e-4)
    np.testing.assert_allclose(trust, 0.4)


def test_surroundings_of_limbs_bend_with_them() -> None:
    """Shells above the same body at rest and bent, with an exact map of the body."""
    bodies = [creature(2000, bend=bend).surface.working for bend in (0.9, 0.0)]
    motion = SimilarityField(
        *(body.vertices for body in bodies), np.ones(2000), zo.eigenbasis(creature(2000).surface, 100)
    )
    above, truth = (body.vertices + 0.005 * body.vertex_normals for body in bodies)
    carried, turned, _ = motion.transform(above, bodies[0].vertex_normals)
    off = np.linalg.norm(carried - truth, axis=1)
    assert off.mean() < 0.005
    assert np.quantile(off, 0.99) < 0.03
    assert np.median(np.einsum("ij,ij->i", turned, bodies[1].vertex_normals)) > 0.98


def test_regions_decide_between_parts_in_one_place() -> None:
    ours = [part_of(sphere(0.1))]
    theirs = [part_of(sphere(0.1), 0.005), part_of(sphere(0.1), -0.02)]
    none = np.zeros((1, 0), bool), np.zeros((2, 0), bool)
    assert pair_parts(ours, theirs, *none)[0] == {0: 0}
    named = np.array([[True, False]]), np.array([[False, True], [True, False]])
    assert pair_parts(ours, theirs, *named)[0] == {0: 1}
    assert pair_parts(ours, theirs[:1], named[0], named[1][:1])[0] == {}


def test_shape_decides_between_parts_of_equal_place_and_size() -> None:
    """A ball, and a ball cut into halves that are joined at the top."""
    points = 0.1 * directions(600, 3)
    triangles = ConvexHull(points).simplices
    crossing = np.ptp(np.sign(points[triangles, 0]), axis=1) > 0
    halves = Surface(points, triangles[~crossing | (points[triangles, 2].min(axis=1) > 0.09)])
    ours, theirs = [part_of(Surface(points, triangles))], [part_of(halves), part_of(Surface(points, triangles), 0.005)]
    none = np.zeros((1, 0), bool), np.zeros((2, 0), bool)
    assert pair_parts(ours, theirs, *none)[0] == {0: 1}
    # A part without rivals in its place is paired despite its shape.
    assert pair_parts(ours, theirs[:1], none[0], none[1][:1])[0] == {0: 0}


def test_hems_are_attracted_to_their_partners() -> None:
    """A tube that the body's map shortens slightly at both ends, and one that is cut shorter."""
    turn, along = (axis.ravel() for axis in np.meshgrid(np.arange(20) * np.pi / 10, np.linspace(0, 1, 20)))
    tube = np.column_stack([0.1 * np.cos(turn), 0.1 * np.sin(turn), along])
    whole = part_of(Surface(tube, ring_faces(20, 20)))
    short, cut = (
        Part(whole.mesh, whole.vertices, whole.triangles, whole.points * [1, 1, length], whole.weights)
        for length in (0.9, 0.6)
    )
    end = along == 1
    for part, missed in ((short, 0.0), (cut, 0.2)):
        off = np.linalg.norm(loops_on_loops(part, whole) - whole.points, axis=1)
        np.testing.assert_allclose(off[end].mean(), missed, atol=0.03)
