# SPDX-License-Identifier: GPL-3.0-or-later
"""Rules of UVs: which faces stay connected, which island a face takes, extrapolation limits, and reports."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from transfer_meshes import identity, nearest_map, plate

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer import Attribute, Domain, Kind, transfer
from zoomout_core.transfer.uv.chart import uv_seams


def transfer_uvs(uv: np.ndarray, surface_map: SurfaceMap, source: Surface, target: Surface) -> Attribute:
    return transfer(Attribute("UVMap", Domain.CORNER, Kind.UV, uv), surface_map, source, target)


def corners(surface: Surface) -> np.ndarray:
    """(c, 2) positions of the corners of a flat surface."""
    return surface.vertices[surface.corner_vertex, :2]


def middles(surface: Surface) -> np.ndarray:
    """(c, 2) centre of each corner's face."""
    size = np.diff(surface.face_start)
    of_face = np.add.reduceat(corners(surface), surface.face_start[:-1]) / size[:, None]
    return np.asarray(of_face[surface.corner_face])


def of_each_face(mask: np.ndarray, surface: Surface) -> np.ndarray:
    """(f,) whether a mask (c,) is true at all corners of a face."""
    return np.logical_and.reduceat(mask, surface.face_start[:-1])


def right_half(surface: Surface) -> np.ndarray:
    """(c, 1) whether the corners' faces are right of the middle."""
    return np.asarray(middles(surface)[:, :1] > 0.5)


def test_overlapping_islands_share_no_corners() -> None:
    # At the seam UVs of both islands differ by only 0.01; faces are 0.12 wide.
    source, target = plate(20, 12), plate(9, 8, jitter=0.2)
    step = np.array([0.01, 0.0])
    uv = transfer_uvs(corners(source) + right_half(source) * step, nearest_map(target.vertices, source), source, target)
    off = uv.values - corners(target)
    left, right = (of_each_face(np.abs(off - place).max(axis=1) < 1e-9, target) for place in (0 * step, step))
    assert (left | right).all()
    across = middles(target)[target.face_start[:-1], 0]
    assert left[across < 0.4].all()
    assert right[across > 0.6].all()


def test_sides_of_a_slit_within_an_island_share_no_corners() -> None:
    # Across the slit UVs differ by up to 0.07, with faces 0.11 wide; above it they agree.
    source, target = plate(20, 20), plate(9, 9, jitter=0.2)

    def chart(places: np.ndarray, beyond: np.ndarray | bool) -> np.ndarray:
        return places + np.stack([0.07 * np.maximum(0.8 - places[:, 1], 0) / 0.8, 0 * places[:, 1]], axis=1) * beyond

    uv = transfer_uvs(
        chart(corners(source), right_half(source)), nearest_map(target.vertices, source), source, target
    ).values
    here = corners(target)
    fits = [of_each_face(np.abs(uv - chart(here, beyond)).max(axis=1) < 1e-9, target) for beyond in (False, True)]
    below = of_each_face(here[:, 1] < 0.3, target)
    assert (fits[0] | fits[1])[below].all()
    assert not (fits[0] & fits[1])[below].any()
    assert fits[0][below].any()
    assert fits[1][below].any()


def test_face_takes_the_island_of_most_of_its_area() -> None:
    # Four small islands cover the innermost samples of a square, for either diagonal.
    source, target = plate(14, 14), plate(1, 1)
    at = np.floor(14 * middles(source))
    spots = sum((at == place).all(axis=1) for place in ([9, 4], [4, 9], [4, 4], [9, 9]))
    uv = corners(source) + 3 * spots[:, None] * np.array([[1.0, 2.0]]) * (1 + at)
    result = transfer_uvs(uv, nearest_map(target.vertices, source), source, target).values
    np.testing.assert_allclose(result, corners(target), atol=1e-9)


def test_extrapolation_beyond_a_border_is_not_steep() -> None:
    # The island ends in a column of faces whose UVs are 40 times as long as elsewhere.
    source, target = plate(20, 4, height=0.2), plate(1, 1, width=0.6, height=0.2)
    target = Surface(target.vertices + np.array([0.05, 0, 0]), [[0, 2, 3, 1]])
    here, slope = corners(source), 40.0
    steep = np.where(here[:, 0] > 0.45, 0.45 + slope * (here[:, 0] - 0.45), here[:, 0])
    left = np.column_stack([steep, here[:, 1]])
    uv = np.where(right_half(source), here + 50, left)
    found = transfer_uvs(uv, nearest_map(target.vertices, source), source, target).values
    border, width = 0.45 + slope * 0.05, 0.65 - 0.5
    mean = np.sqrt(border * 0.2 / (0.5 * 0.2))
    assert found[:, 0].min() == pytest.approx(0.05)
    beyond = found[:, 0].max() - border
    assert mean * width < beyond < 8 * mean * width


def squares(sides: np.ndarray, corner: tuple[float, float]) -> np.ndarray:
    """(4k, 2) corners of squares that share a corner."""
    outline = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    return (np.array(corner) + outline * sides[:, None, None]).reshape(-1, 2)


def flat(places: np.ndarray, faces: np.ndarray) -> Surface:
    return Surface(np.column_stack([places, np.zeros(len(places))]), faces)


@pytest.mark.parametrize(
    ("factors", "stretched", "collapsed"),
    [((4.5, 1 / 4.5, 1 / 50), 2, 1), ((3.5, 1 / 3.5, 1 / 20), 1, 0), ((6, 1, 1), 1, 0), ((1, 1 / 6, 1), 1, 0)],
)
def test_stretched_and_collapsed_faces_are_reported(factors: tuple[float, ...], stretched: int, collapsed: int) -> None:
    # 100 loose squares with the source's total area; three map to larger or smaller parts of it.
    source, count = plate(20, 20), 100
    sides = np.full(count, 0.1)
    grid = np.stack(np.divmod(np.arange(count), 10), axis=1) * 0.2
    faces = np.arange(4 * count).reshape(-1, 4)
    target = flat(squares(sides, (0, 0)) + np.repeat(grid, 4, axis=0), faces)
    sides[[17, 44, 80]] *= factors
    images = np.column_stack([squares(sides, (0.21, 0.32)), np.zeros(4 * count)])
    notes = transfer_uvs(corners(source), nearest_map(images, source), source, target).notes
    told = {note.split("faces have ")[1].split(" ")[0]: int(note.split()[1].replace(",", "")) for note in notes}
    assert told.pop("strongly", 0) == stretched
    assert told.pop("collapsed", 0) == collapsed
    assert not told


def bend_at_knee(places: np.ndarray, knee: float, below: float, above: float) -> np.ndarray:
    """Scale places (c, 2) along each axis by one factor below a knee and another above it."""
    return np.where(places < knee, below * places, below * knee + above * (places - knee))


@pytest.mark.parametrize(("knee", "below", "above"), [(0.9, 1, 12), (0.9, 1, 1 / 12), (0.05, 1 / 12, 1)])
def test_uneven_density_on_the_source_is_not_reported(knee: float, below: float, above: float) -> None:
    source = plate(20, 20)
    dense = bend_at_knee(corners(source), knee, below, above)
    assert transfer_uvs(dense, identity(source), source, source).notes == ()
    # The corner that samples the source's density is in the sparse region, the face is not.
    coarse = plate(4, 4)
    assert transfer_uvs(dense, nearest_map(coarse.vertices, source), source, coarse).notes == ()


def test_less_trusted_samples_of_a_face_count_less() -> None:
    source, target = plate(20, 20), plate(1, 1)
    uv = np.where(right_half(source), corners(source) + 5, corners(source))
    surface_map = nearest_map(target.vertices, source)
    taken = []
    for trusted in (target.vertices[:, 0] < 0.5, target.vertices[:, 0] > 0.5):
        match = SimpleNamespace(has_partner=None, surface_map=surface_map, confidence=np.where(trusted, 1.0, 0.0))
        taken.append(transfer_uvs(uv, match, source, target).values.mean(axis=0)[0] > 2)
    assert taken == [False, True]


def test_votes_go_by_area_if_nothing_is_trusted() -> None:
    source, target = plate(20, 20), plate(1, 1)
    uv = np.where(middles(source)[:, :1] > 0.7, corners(source) + 5, corners(source))
    match = SimpleNamespace(has_partner=None, surface_map=nearest_map(target.vertices, source), confidence=np.zeros(4))
    np.testing.assert_allclose(transfer_uvs(uv, match, source, target).values, corners(target), atol=1e-9)


@pytest.mark.parametrize("side", [0, 1])
def test_uvs_stay_in_the_tile_of_islands_within_one_tile(side: int) -> None:
    # Each island is as wide as a tile; a face extends 0.2 beyond the seam.
    source, target = plate(20, 10, width=2), plate(1, 1, width=1.2)
    target = target.with_vertices(target.vertices + np.array([0.8 * side, 0, 0]))
    uv = np.where(middles(source)[:, :1] > 1, corners(source) + np.array([7, 0]), corners(source))
    here = nearest_map(target.vertices, source)
    expected = np.array([[0, 0], [1, 1]]) + np.array([8 * side, 0])
    found = transfer_uvs(uv, here, source, target).values
    np.testing.assert_allclose([found.min(axis=0), found.max(axis=0)], expected, atol=1e-9)
    shift = np.array([0.1, 0])
    across_tiles = transfer_uvs(uv + shift, here, source, target).values
    expected = expected + shift + ([[-0.2, 0], [0, 0]] if side else [[0, 0], [0.2, 0]])
    np.testing.assert_allclose([across_tiles.min(axis=0), across_tiles.max(axis=0)], expected, atol=1e-9)


def test_uv_seams_are_where_the_atlas_jumps_but_not_its_borders() -> None:
    mesh = plate(6, 4)
    uv = np.where(right_half(mesh), corners(mesh) + 3, corners(mesh))
    on_seam = (np.abs(mesh.vertices[mesh.edges][:, :, 0] - 0.5) < 1e-9).all(axis=1)
    np.testing.assert_array_equal(uv_seams(mesh, uv), on_seam)
    assert on_seam.sum() == 4
    rounding = np.random.default_rng(0).uniform(-1, 1, uv.shape) * 1e-6
    np.testing.assert_array_equal(uv_seams(mesh, uv + rounding), on_seam)
    assert not uv_seams(mesh, corners(mesh)).any()


def two_islands(surface: Surface) -> np.ndarray:
    """(c, 2) UVs of a plate that is cut open in the middle, with the right half far away."""
    return corners(surface) + right_half(surface) * np.array([5.0, 0.0])


@pytest.mark.parametrize("at_seam", [False, True])
def test_unknown_uv_of_one_corner_is_that_of_the_face_beside_it(at_seam: bool) -> None:
    surface = plate(20, 20)
    uv = two_islands(surface)
    place = np.array([0.5 if at_seam else 0.3, 0.5])
    corner = int(np.abs(corners(surface) - place).sum(axis=1).argmin())
    broken = uv.copy()
    broken[corner] = np.nan
    found = transfer_uvs(broken, identity(surface), surface, surface)
    np.testing.assert_allclose(found.values, uv, atol=1e-9)
    assert found.notes[0].startswith(f"1 of {len(uv):,} values of 'UVMap' are not finite")


@pytest.mark.parametrize("across", [0.3, 0.5])
def test_unknown_uvs_of_a_vertex_are_those_around_it_on_each_island(across: float) -> None:
    # At a border of an island the corners around are on one side, so that the mean is up to half a face off.
    surface = plate(20, 20)
    uv = two_islands(surface)
    vertex = np.abs(surface.vertices[:, :2] - [across, 0.5]).sum(axis=1).argmin()
    unknown = surface.corner_vertex == vertex
    broken = uv.copy()
    broken[unknown] = np.inf
    found = transfer_uvs(broken, identity(surface), surface, surface).values
    np.testing.assert_allclose(found[~unknown], uv[~unknown], atol=1e-9)
    assert np.abs(found - uv)[unknown].max() < (1e-9 if across < 0.5 else 0.6 / 19)


def mirrored_uvs(surface: Surface) -> np.ndarray:
    """(c, 2) UVs of a plate whose right half shows the texture of the left one."""
    return np.abs(corners(surface) - [0.5, 0.0])


@pytest.mark.parametrize("columns", [9, 10])
def test_faces_across_the_middle_of_mirrored_uvs_are_reported(columns: int) -> None:
    # The middle of nine columns of faces is across the fold; ten columns have an edge there.
    source, target = plate(20, 12), plate(columns, 8)
    notes = transfer_uvs(mirrored_uvs(source), nearest_map(target.vertices, source), source, target).notes
    found = [note for note in notes if "the source's UVs are mirrored" in note]
    assert len(found) == (columns == 9)
    assert all(note.startswith("UVMap: 11.1% of the area is on faces across which") for note in found)
