# SPDX-License-Identifier: GPL-3.0-or-later
"""Patches of a bone that are cut off from its region are found and filled in, unless the source has them as well."""

from __future__ import annotations

import numpy as np
from bent_tube import tube, weights_of
from scipy.sparse import csr_array

import zoomout_core as zo
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.transfer import Attribute, Domain, Kind, map_target
from zoomout_core.transfer.rigging.weight_islands import find_islands
from zoomout_core.transfer.rigging.weights import mix_weights

SOURCE, TARGET = tube(20, 61), tube(15, 47, turned=0.4)


def image(moved: np.ndarray | None = None, up: float = 4.5) -> zo.SurfaceMap:
    """The true map, except that the vertices of a mask (n,) map to a place farther up."""
    points = (
        TARGET.vertices
        if moved is None
        else np.where(moved[:, None], TARGET.vertices + np.array([0, 0, up]), TARGET.vertices)
    )
    return zo.SurfaceMap(*closest_points(points, SOURCE.vertices, SOURCE.triangles), SOURCE.triangles)


def near(surface: zo.Surface, height: float, radius: float = 0.4) -> np.ndarray:
    return np.linalg.norm(surface.vertices - [0.6, 0, height], axis=1) < radius


def islands(surface_map: zo.SurfaceMap, of_source: csr_array) -> np.ndarray:
    weights = csr_array(surface_map.interpolate(of_source.toarray()))
    return find_islands(surface_map, SOURCE, of_source, TARGET, weights) >= 0


def test_a_patch_of_another_bone_is_an_island() -> None:
    patch = near(TARGET, 1.0)
    np.testing.assert_array_equal(islands(image(patch), weights_of(SOURCE.vertices)), patch)


def test_true_weights_have_no_islands() -> None:
    assert not islands(image(), weights_of(SOURCE.vertices)).any()


def test_regions_separate_on_the_source_are_no_islands() -> None:
    of_source = weights_of(SOURCE.vertices).toarray()
    of_source[near(SOURCE, 1.0, 0.6)] = [0, 0, 1]  # the topmost bone moves a patch below as well
    assert not islands(image(), csr_array(of_source)).any()


def test_large_regions_are_no_islands() -> None:
    low = TARGET.vertices[:, 2] < 1.5
    assert not islands(image(low), weights_of(SOURCE.vertices)).any()


def test_regions_on_several_loose_parts_are_no_islands() -> None:
    # The same tube in two pieces: the topmost bone moves both of their upper ends.
    source, target = (
        zo.Surface.joined([each, each.with_vertices(0.3 * each.vertices + [5, 0, 4])]) for each in (SOURCE, TARGET)
    )
    weights = csr_array(np.tile([[1.0]], (len(target.vertices), 1)))
    found = closest_points(target.vertices, source.vertices, source.triangles)
    ones = csr_array(np.ones((len(source.vertices), 1)))
    assert (find_islands(zo.SurfaceMap(*found, source.triangles), source, ones, target, weights) < 0).all()


def test_vertices_without_weights_are_no_islands() -> None:
    of_source = weights_of(SOURCE.vertices).toarray()
    of_source[SOURCE.vertices[:, 2] > 4] = 0
    assert not islands(image(near(TARGET, 1.0)), csr_array(of_source)).any()


def test_islands_in_transferred_weights_are_filled_in() -> None:
    patch = near(TARGET, 1.0)
    mapped = map_target(zo.ProximityMatch(image(patch), np.ones(len(patch)), ()), SOURCE, TARGET)
    weights = Attribute("w", Domain.POINT, Kind.WEIGHT, weights_of(SOURCE.vertices), labels=("A", "B", "C"))
    made = mix_weights(weights, mapped)
    assert np.abs(made.values.toarray() - weights_of(TARGET.vertices).toarray()).max() < 0.1
    assert made.notes == (f"{patch.sum():,} stray weights, far from the rest of their bone, were replaced.",)
