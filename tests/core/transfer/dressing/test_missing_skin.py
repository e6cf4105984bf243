# SPDX-License-Identifier: GPL-3.0-or-later
"""Clothes of bodies that lack the skin below them, on mannequins."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mannequins import STEP, Mannequin, mannequin
from rigged_mannequins import rigged
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.dressing import missing_skin
from zoomout_core.transfer.dressing.missing_skin import (
    ClothedBody,
    complete_body,
    place_by_bones,
    without_missing_limbs,
)
from zoomout_core.transfer.rigging.joint_map import RiggedBody, SharedJoints

LEGS = ("thigh.L", "thigh.R", "shin.L", "shin.R")


def cloth_around(body: Mannequin, parts: Sequence[str], wide: float = 1.3) -> tuple[Surface, csr_array]:
    """Cloth around parts of a mannequin that is wider than the skin, and its weights."""
    whole = rigged(body, body)
    chosen = np.isin(body.part, parts)
    vertices = body.surface.vertices.copy()
    for part in parts:
        middle = vertices[body.part == part].mean(axis=0)
        vertices[body.part == part] = middle + (vertices[body.part == part] - middle) * [wide, wide, 1]
    number = np.cumsum(chosen) - 1
    triangles = body.surface.triangles[chosen[body.surface.triangles].all(axis=1)]
    return Surface(vertices[chosen], number[triangles]), csr_array(whole.weights[chosen])


def without(parts: Sequence[str]) -> RiggedBody:
    """A mannequin at rest without the skin of some parts."""
    body = mannequin()
    bare, whole = rigged(body, body), np.isin(body.part, parts, invert=True)
    number = np.cumsum(whole) - 1
    triangles = body.surface.triangles[whole[body.surface.triangles].all(axis=1)]
    surface = Surface(body.surface.vertices[whole], number[triangles])
    return RiggedBody(surface, bare.bones, csr_array(bare.weights[whole]))


def trousers_alone() -> tuple[ClothedBody, Surface]:
    cloth, weights = cloth_around(mannequin(), LEGS)
    found = complete_body(without(LEGS), [cloth], [weights])
    assert found is not None
    return found, cloth


def test_cloth_without_skin_below_it_stands_in_for_skin() -> None:
    found, cloth = trousers_alone()
    assert found.skin == len(without(LEGS).surface.vertices)
    # The ends of the shells are around skin of the torso and the feet.
    assert found.share > 0.7
    added = found.body.surface.vertices[found.skin :]
    off = np.linalg.norm(added[:, None] - cloth.vertices, axis=2).min(axis=1)
    depth = missing_skin.DEPTH * np.sqrt(without(LEGS).surface.area + cloth.area)
    np.testing.assert_allclose(off, depth, rtol=0.3)
    legs = [found.body.bones.names.index(part) for part in LEGS]
    np.testing.assert_allclose(found.body.weights[found.skin :][:, legs].sum(axis=1), 1)


def test_cloth_over_skin_does_not() -> None:
    body = mannequin()
    cloth, weights = cloth_around(body, LEGS)
    assert complete_body(rigged(body, body), [cloth], [weights]) is None


def test_only_the_innermost_layer_stands_in_for_skin() -> None:
    body = mannequin()
    (inner, weights), (outer, _) = cloth_around(body, LEGS, 1.3), cloth_around(body, LEGS, 1.8)
    found = complete_body(without(LEGS), [outer, inner], [weights, weights])
    assert found is not None
    added = found.body.surface.vertices[found.skin :]
    to_inner, to_outer = (np.linalg.norm(added[:, None] - each.vertices, axis=2).min(axis=1) for each in (inner, outer))
    assert (to_inner < to_outer).mean() > 0.9


def test_bodies_with_unknown_bones_stay_as_they_are() -> None:
    cloth, weights = cloth_around(mannequin(), LEGS)
    body = without(LEGS)
    unknown = body._replace(bones=body.bones._replace(humanoid={}))
    assert complete_body(unknown, [cloth], [weights]) is None


def test_bones_place_such_cloth() -> None:
    """Trousers follow a step to longer and thinner legs, and become narrower with them."""
    found, _ = trousers_alone()
    build = 0.5, 0.7, 1.3
    thin = mannequin(STEP, seed=3, build=build)
    target = rigged(thin, mannequin(seed=3, build=build), build)
    joints = SharedJoints.of(found.body, target)
    assert joints is not None
    wide = joints.stretch_source()
    shape = joints.project_source(wide)
    placed = place_by_bones(found, shape, target)
    assert placed is not None
    np.testing.assert_array_equal(placed.cloth[: found.skin], shape[: found.skin])
    bone = np.asarray(found.body.weights.argmax(axis=1)).ravel()[found.skin :]
    for part in LEGS:
        leg, chosen = thin.surface.vertices[thin.part == part], bone == found.body.bones.names.index(part)
        cloth, skin, before = (each[found.skin :][chosen] for each in (*placed, wide))
        assert np.linalg.norm(cloth.mean(axis=0) - leg.mean(axis=0)) < 0.06
        far, close, none = (cKDTree(leg).query(each)[0].mean() for each in (before, cloth, skin))
        assert close < 0.8 * far
        assert none < 0.8 * close


def test_loose_cloth_keeps_its_girth() -> None:
    """Cloth that is as far from the legs as a skirt is not pressed onto them."""
    body = mannequin()
    found, _ = trousers_alone()
    joints = SharedJoints.of(found.body, rigged(body, body))
    assert joints is not None
    vertices, far = found.body.surface.vertices, np.arange(len(found.body.surface.vertices)) >= found.skin
    shape = vertices + 0.5 * far[:, None] * [0, 0, 1]
    placed = place_by_bones(found, shape, rigged(body, body))
    assert placed is not None
    assert np.linalg.norm(placed.cloth - vertices, axis=1).max() < 0.1


def test_bodies_without_common_bones_are_left_to_their_map() -> None:
    found, _ = trousers_alone()
    body = mannequin()
    target = rigged(body, body)
    unknown = target._replace(bones=target.bones._replace(humanoid={}))
    assert place_by_bones(found, found.body.surface.vertices, unknown) is None


def test_cloth_of_limbs_that_the_other_body_lacks_is_left_out() -> None:
    found, _ = trousers_alone()
    names = found.body.bones.names
    kept = without_missing_limbs(found, np.array([name != LEGS[0] for name in names]))
    bone = np.asarray(found.body.weights.argmax(axis=1)).ravel()
    assert kept[: found.skin].all()
    np.testing.assert_array_equal(kept[found.skin :], bone[found.skin :] != names.index(LEGS[0]))
    assert not kept.all()
