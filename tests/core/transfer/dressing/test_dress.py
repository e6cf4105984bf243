# SPDX-License-Identifier: GPL-3.0-or-later
"""Dress a body in another one's clothes, on balls and eggs with analytic distances to the skin."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_lengths, unique_edges
from zoomout_core.runtime.progress import Progress
from zoomout_core.samples.spheres import ball
from zoomout_core.transfer import Lines, dress, fit_to_shape
from zoomout_core.transfer.dressing.barriers import CONTACT, SidedSurface
from zoomout_core.transfer.dressing.following import FOLLOWING
from zoomout_core.transfer.dressing.solid_parts import SOLID
from zoomout_core.tuning import retune

TURN, MOVED, SIZE = Rotation.from_rotvec([0.4, -1.1, 0.7]), np.array([500.0, -20, 90]), 40.0
RADII = np.array([1.0, 0.8, 1.3])
BODY = ball(1, count=2500, seed=3)
UNIT = np.sqrt(BODY.area)


def onto_egg(points: np.ndarray) -> np.ndarray:
    """Map points around the body to the space around the egg."""
    return np.asarray(SIZE * TURN.apply(points * RADII) + MOVED)


def off_egg(points: np.ndarray) -> np.ndarray:
    """Approximate distance of points outside the egg, relative to its size."""
    back = TURN.inv().apply(np.asarray(points) - MOVED) / SIZE
    level = np.linalg.norm(back / RADII, axis=1)
    return np.asarray((level - 1) * level / np.linalg.norm(back / RADII**2, axis=1))


EGG = BODY.with_vertices(onto_egg(BODY.vertices))


def noisy(amount: float) -> np.ndarray:
    """The egg's vertices as a bad match displaces them, inside and outside its skin."""
    wave = np.sin(9 * BODY.vertices[:, :1]) * np.sin(7 * BODY.vertices[:, 1:2])
    return onto_egg(BODY.vertices * (1 + amount * wave))


def shell(radius: float, count: int = 600) -> Surface:
    """Half a ball around the body."""
    whole = ball(radius, count=count, seed=5)
    return Surface(whole.vertices, whole.triangles[whole.vertices[whole.triangles][:, :, 2].min(axis=1) > -0.2])


def similar(points: np.ndarray, rest: np.ndarray) -> float:
    """Greatest distance of points from the best similarity of `rest`, relative to their extent."""
    return float(np.linalg.norm(procrustes(rest, points)(rest) - points, axis=1).max() / np.ptp(points, axis=0).max())


def test_clothes_keep_their_distance_to_the_skin_in_every_unit() -> None:
    shirt = shell(1.06)
    carried = fit_to_shape(BODY, EGG.vertices, EGG, [shirt])
    worn = shirt.triangles.ravel()
    off = off_egg(carried.vertices[0][worn])
    assert abs(np.median(off) - 0.06) < 0.01
    assert off.min() > 0.035
    small = fit_to_shape(BODY, EGG.vertices / 1e4, EGG.with_vertices(EGG.vertices / 1e4), [shirt])
    np.testing.assert_allclose(small.vertices[0], carried.vertices[0] / 1e4, rtol=0, atol=1e-6)
    assert not carried.notes


def test_dress_needs_only_a_match_and_reports_progress() -> None:
    told: list[Progress] = []
    body, egg = ball(1, count=700, seed=1), ball(1, count=600, seed=2)
    target = egg.with_vertices(onto_egg(egg.vertices))
    shirt = shell(1.06, 300)
    given = SurfaceMap.from_vertices(nearest(egg.vertices, body.vertices), body)
    found = dress(given, body, target, [shirt], progress=told.append)
    true = onto_egg(shirt.vertices)
    worn = np.unique(shirt.triangles)
    assert np.linalg.norm(found.vertices[0] - true, axis=1)[worn].mean() < 0.04 * SIZE
    fractions = [one.fraction for one in told]
    assert fractions == sorted(fractions)
    assert (fractions[0], fractions[-1]) == (0, 1)
    stages = list(dict.fromkeys(one.stage for one in told if one.stage))
    assert stages == ["Wrapping", "Inverting the match", "Dressing"]


def nearest(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(q,) number of the nearest of the others for each point."""
    return np.asarray(np.linalg.norm(points[:, None] - others, axis=2).argmin(axis=1))


def test_clothes_are_not_pushed_into_the_skin() -> None:
    shirt = shell(1.02)
    worn = np.unique(shirt.triangles)
    with retune(CONTACT, rounds=0):
        sunk = fit_to_shape(BODY, noisy(0.05), EGG, [shirt])
    assert (off_egg(sunk.vertices[0][worn]) < 0).mean() > 0.1
    assert "still intersect the skin" in sunk.notes[0]
    held = fit_to_shape(BODY, noisy(0.05), EGG, [shirt])
    assert off_egg(held.vertices[0][worn]).min() > 0
    assert not held.notes


def test_requested_gap_is_kept() -> None:
    shirt = shell(1.02)
    found = fit_to_shape(BODY, EGG.vertices, EGG, [shirt], gap=0.05 * SIZE)
    assert off_egg(found.vertices[0][np.unique(shirt.triangles)]).min() > 0.04


def test_shallow_penetration_is_resolved() -> None:
    shirt = shell(0.99)
    worn = np.unique(shirt.triangles)
    with retune(CONTACT, mended=0.0):
        assert off_egg(fit_to_shape(BODY, EGG.vertices, EGG, [shirt]).vertices[0][worn]).max() < 0
    assert off_egg(fit_to_shape(BODY, EGG.vertices, EGG, [shirt]).vertices[0][worn]).min() > -0.002


def test_skin_does_not_penetrate_large_faces() -> None:
    """A coarse shirt covers a body whose narrow bump misses the shirt's vertices, edge centres and face centres."""
    shirt = shell(1.06, 80)
    corner = shirt.triangles[0]
    place = np.array([0.6, 0.2, 0.2]) @ shirt.vertices[corner]
    place /= np.linalg.norm(place)
    bump = 1 + 0.08 * np.exp(-(np.linalg.norm(BODY.vertices - place, axis=1, keepdims=True) ** 2) / 0.003)
    bumpy = BODY.with_vertices(BODY.vertices * bump)
    worn = fit_to_shape(BODY, BODY.vertices, bumpy, [shirt]).vertices[0]
    corners = worn[corner]
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal *= np.sign(normal @ place) / np.linalg.norm(normal)
    peak = bumpy.vertices[np.argmax(bump)]
    assert (corners[0] - peak) @ normal > -0.003
    assert (shirt.vertices[corner[0]] - peak) @ normal < -0.02


@pytest.mark.parametrize("in_one_object", [False, True])
def test_layers_keep_their_order(in_one_object: bool) -> None:
    shirt, jacket = shell(1.02), ball(1.04, count=500, seed=9)
    jacket = Surface(jacket.vertices, jacket.triangles[jacket.vertices[jacket.triangles][:, :, 2].min(axis=1) > 0.2])
    worn = np.unique(jacket.triangles)

    def between() -> float:
        """Smallest distance (2nd percentile) of the jacket from the shirt, by their radii."""
        worn_things = [Surface.joined([shirt, jacket])] if in_one_object else [shirt, jacket]
        every = np.concatenate(fit_to_shape(BODY, noisy(0.1), EGG, worn_things).vertices)
        under, over = np.split(every, [len(shirt.vertices)])
        middles = under[shirt.triangles].mean(axis=1)
        near = nearest(over[worn], middles)
        return float(np.quantile(off_egg(over[worn]) - off_egg(middles[near]), 0.02))

    with retune(CONTACT, layer_reach=0.0):
        without = between()
    assert between() > max(without, 0)


def test_intersecting_outfits_do_not_displace_each_other() -> None:
    shirt, other = shell(1.04), shell(1.04, count=700)
    other = other.with_vertices(other.vertices * (1 + 0.015 * np.sin(8 * other.vertices[:, :1])))

    def displaced() -> float:
        """Greatest displacement of either by the other one, relative to the size."""
        together = fit_to_shape(BODY, EGG.vertices, EGG, [shirt, other]).vertices
        alone = [fit_to_shape(BODY, EGG.vertices, EGG, [each]).vertices[0] for each in (shirt, other)]
        return max(float(np.abs(a - b).max()) / SIZE for a, b in zip(together, alone, strict=True))

    assert displaced() == 0
    with retune(CONTACT, over=0.0):
        assert displaced() > 0


def test_solid_parts_keep_their_shape() -> None:
    eye = ball(0.06, centre=(0, 0, 1.02), count=100)
    found = fit_to_shape(BODY, EGG.vertices, EGG, [eye])
    assert similar(found.vertices[0], eye.vertices) < 1e-6
    with retune(SOLID, small=0.0):
        assert similar(fit_to_shape(BODY, EGG.vertices, EGG, [eye]).vertices[0], eye.vertices) > 0.01
    soft = fit_to_shape(BODY, EGG.vertices, EGG, [eye], manners=["soft"])
    assert similar(soft.vertices[0], eye.vertices) > 0.01


def test_button_follows_its_shirt() -> None:
    shirt, button = shell(1.03), ball(0.02, centre=(0, 0, 1.055), count=60)
    both = Surface.joined([shirt, button])
    found = fit_to_shape(BODY, noisy(0.05), EGG, [both]).vertices[0]
    place = found[len(shirt.vertices) :]
    assert similar(place, button.vertices) < 1e-6
    worn = np.unique(shirt.triangles)
    over = worn[nearest(button.vertices.mean(axis=0)[None], shirt.vertices[worn])[0]]
    gap = np.linalg.norm(place.mean(axis=0) - found[over]) / SIZE
    before = np.linalg.norm(button.vertices.mean(axis=0) - shirt.vertices[over])
    assert abs(gap - before) < 0.03


def test_prop_stays_rigid_and_outside_the_skin() -> None:
    rod = ball(0.5, centre=(0, 0, 1.13), radii=(1, 0.2, 0.2), count=200)
    found = fit_to_shape(BODY, noisy(0.05), EGG, [rod], manners=["rigid"]).vertices[0]
    assert similar(found, rod.vertices) < 1e-6
    before = np.linalg.norm(rod.vertices, axis=1).min()
    assert before > 1.02
    assert off_egg(found).min() > -0.01


def test_hair_hangs_as_a_whole_and_follows_the_skin_at_its_roots() -> None:
    wig = ball(1.02, count=600, seed=5)
    wig = Surface(wig.vertices, wig.triangles[wig.vertices[wig.triangles][:, :, 2].min(axis=1) > 0.5])
    tail = ball(0.1, centre=(1.35, 0, -0.2), radii=(0.2, 2, 6), count=200)
    # The body grows at the tail, and has a dent below the top of the wig.
    towards = np.array([1.0, 0, -0.2]) / np.linalg.norm([1.0, 0, -0.2])
    beside = np.exp(-((1 - BODY.vertices @ towards) ** 2) / 0.1)
    above = np.exp(-((1 - BODY.vertices[:, 2]) ** 2) / 0.01)
    grown = BODY.with_vertices(BODY.vertices * (1 + 0.25 * beside - 0.06 * above)[:, None])
    soft, hair = (
        fit_to_shape(BODY, grown.vertices, grown, [wig, tail], manners=[manner] * 2).vertices
        for manner in ("soft", "hair")
    )
    off = [np.linalg.norm(found[1] - tail.vertices, axis=1).mean() for found in (soft, hair)]
    assert off[0] > 0.15
    assert off[1] < 0.5 * off[0]
    worn = np.unique(wig.triangles)
    top = worn[wig.vertices[worn, 2].argmax()]
    assert hair[0][top, 2] < 0.98


def test_strands_keep_their_roots_on_the_skin_and_turn_with_it() -> None:
    roots = ball(1, count=40, seed=4).vertices
    strands = np.concatenate([roots * (1 + 0.05 * number) for number in range(5)])
    edges = np.concatenate([np.stack([np.arange(40), 40 + np.arange(40)], axis=1) + 40 * number for number in range(4)])
    found = fit_to_shape(BODY, EGG.vertices, EGG, [Lines(strands, edges)])
    points = found.vertices[0].reshape(5, 40, 3)
    assert np.abs(off_egg(points[0])).max() < 0.01
    length = np.linalg.norm(points[4] - points[0], axis=1) / SIZE
    assert np.abs(length / np.median(length) - 1).max() < 0.35
    assert found.turns[0].shape == (200, 3, 3)


def test_distant_cloth_follows_a_wide_patch_of_skin() -> None:
    """A wide skirt does not tear where the map beneath it tears."""
    torn = BODY.vertices + 0.1 * np.sign(np.sin(25 * BODY.vertices[:, :1])) * [0, 1, 0]
    skirt = shell(1.6)
    worn = np.unique(skirt.triangles)

    def off() -> float:
        found = fit_to_shape(BODY, torn, BODY, [skirt], stiffness=0.0).vertices[0]
        return float(np.linalg.norm(found - skirt.vertices, axis=1)[worn].mean())

    with retune(FOLLOWING, spreading=0.0):
        narrow = off()
    assert off() < 0.9 * narrow


def test_stiff_cloth_keeps_its_shape() -> None:
    shirt = shell(1.2)
    worn = np.unique(shirt.triangles)
    errors = [
        similar(fit_to_shape(BODY, noisy(0.08), EGG, [shirt], stiffness=value).vertices[0][worn], shirt.vertices[worn])
        for value in (0.0, 1.0)
    ]
    assert errors[1] < 0.9 * errors[0]


def plate(shirt: Surface, place: tuple[float, float, float] = (0, 0, 1.03), radius: float = 0.3) -> np.ndarray:
    """(n,) a mask of the shirt's vertices around a place."""
    return np.asarray(np.linalg.norm(shirt.vertices - place, axis=1) < radius, float)


def strips(count: int) -> tuple[Surface, np.ndarray, np.ndarray]:
    """A shell of loose strips that touch, and (p,) numbers of vertices on either side of their borders."""
    whole = shell(1.1, 1500)
    strip = np.floor(count * (whole.vertices[whole.triangles].mean(axis=1)[:, 0] / 2.2 + 0.5)).astype(int)
    parts = []
    for number in range(count):
        used, corners = np.unique(whole.triangles[strip == number], return_inverse=True)
        parts.append((used, whole.vertices[used] * (1 + 0.002 * (number % 2)), corners.reshape(-1, 3)))
    number = np.concatenate([used for used, _, _ in parts])
    order = np.argsort(number, kind="stable")
    same = np.flatnonzero(np.diff(number[order]) == 0)
    return Surface.joined([Surface(points, corners) for _, points, corners in parts]), order[same], order[same + 1]


def test_touching_loose_parts_stay_together() -> None:
    braid, first, second = strips(6)

    def drift() -> float:
        """Mean change of the distance between touching vertices, relative to the size."""
        worn = fit_to_shape(BODY, noisy(0.08), EGG, [braid], stiffness=1.0).vertices[0]
        return float(np.linalg.norm(worn[first] - worn[second], axis=1).mean() / SIZE)

    with retune(SOLID, touching=0.0):
        loose = drift()
    assert drift() < 0.5 * loose


def test_masked_patches_keep_their_shape_at_the_garment_scale() -> None:
    shirt = shell(1.03, 1500)
    masks = plate(shirt), plate(shirt, (0.73, 0, 0.73))
    soft, kept = (fit_to_shape(BODY, noisy(0.05), EGG, [shirt], keep=keep) for keep in (None, [masks[0] + masks[1]]))
    sizes = []
    for mask in masks:
        chosen = np.flatnonzero(mask)
        assert similar(soft.vertices[0][chosen], shirt.vertices[chosen]) > 0.05
        assert similar(kept.vertices[0][chosen], shirt.vertices[chosen]) < 1e-5
        motion = procrustes(shirt.vertices[chosen], kept.vertices[0][chosen])
        np.testing.assert_allclose(
            kept.turns[0][chosen], np.broadcast_to(motion.linear, (len(chosen), 3, 3)), atol=0.01
        )
        sizes.append(motion.scale)
    growth = np.linalg.norm(soft.turns[0][np.unique(shirt.triangles)][:, 0], axis=1)
    np.testing.assert_allclose(sizes, np.median(growth), rtol=1e-4)
    # Each moves on its own, to where its vertices would go, and the cloth around continues it.
    assert np.linalg.norm((kept.vertices[0] - soft.vertices[0])[masks[0] > 0].mean(axis=0)) < 0.05 * SIZE
    assert similar(kept.vertices[0][masks[0] + masks[1] > 0], shirt.vertices[masks[0] + masks[1] > 0]) > 0.01
    assert not kept.stretched[0].any()
    edges, _ = unique_edges(shirt.triangles)
    rim = edges[np.ptp((masks[0] + masks[1])[edges], axis=1) > 0]
    assert np.std(edge_lengths(kept.vertices[0], rim) / edge_lengths(soft.vertices[0], rim)) < 0.18


def test_a_masked_button_has_the_scale_of_its_shirt() -> None:
    shirt, button = shell(1.03), ball(0.02, centre=(0, 0, 1.055), count=60)
    both, number = Surface.joined([shirt, button]), len(shirt.vertices)
    mask = np.where(np.arange(number + len(button.vertices)) < number, 0.0, 1.0)
    found = fit_to_shape(BODY, noisy(0.05), EGG, [both], keep=[mask])
    growth = np.linalg.norm(found.turns[0][np.unique(shirt.triangles)][:, 0], axis=1)
    scale = procrustes(button.vertices, found.vertices[0][number:]).scale
    np.testing.assert_allclose(scale, np.median(growth), rtol=0.03)  # which includes the button itself


def test_half_masked_patch_deforms_half_as_much() -> None:
    shirt = shell(1.03, 800)
    mask = plate(shirt)
    soft, half = (fit_to_shape(BODY, noisy(0.05), EGG, [shirt], keep=[share * mask]).vertices[0] for share in (0, 0.5))
    bent = [similar(worn[mask > 0], shirt.vertices[mask > 0]) for worn in (soft, half)]
    assert 0.3 < bent[1] / bent[0] < 0.7


def test_masked_patch_leaves_the_skin_as_a_whole() -> None:
    shirt = shell(1.03, 800)
    mask = plate(shirt)
    bump = 1 + 0.1 * np.exp(-(np.linalg.norm(BODY.vertices - [0.2, 0, 1], axis=1, keepdims=True) ** 2) / 0.01)
    bumpy, chosen = BODY.with_vertices(BODY.vertices * bump), np.flatnonzero(mask)
    skin, inside = SidedSurface.of(bumpy, 1.0), list[float]()
    for rounds in (0, CONTACT.rounds):
        with retune(CONTACT, rounds=rounds):
            worn = fit_to_shape(BODY, BODY.vertices, bumpy, [shirt], keep=[mask]).vertices[0]
        assert similar(worn[chosen], shirt.vertices[chosen]) < 1e-5
        inside.append(skin.sides(worn[chosen])[0].min())
    assert inside[0] < -0.01
    assert inside[1] > 0


def test_a_masked_patch_turns_about_what_pushes_it() -> None:
    """A bump below one end of a plate lifts that end, and hardly the other one."""
    shirt = shell(1.03, 800)
    mask = plate(shirt)
    bump = 1 + 0.1 * np.exp(-(np.linalg.norm(BODY.vertices - [0.25, 0, 1], axis=1, keepdims=True) ** 2) / 0.01)
    chosen = np.flatnonzero(mask)
    dressed = fit_to_shape(BODY, BODY.vertices, BODY.with_vertices(BODY.vertices * bump), [shirt], keep=[mask])
    before, after = shirt.vertices[chosen], dressed.vertices[0][chosen]
    motion = procrustes(before, after)
    assert np.linalg.norm(motion(before) - after, axis=1).max() < 1e-5
    assert motion.rotation.trace() < 1 + 2 * np.cos(np.radians(4))
    near, far = (int(np.argmax(sign * before[:, 0])) for sign in (1, -1))
    lifted = np.linalg.norm(after, axis=1) - np.linalg.norm(before, axis=1)
    assert lifted[near] > 0.03
    assert abs(lifted[far]) < 0.3 * lifted[near]
    # Normals and shape keys rotate with it.
    np.testing.assert_allclose(dressed.turns[0][chosen], np.broadcast_to(motion.linear, (len(chosen), 3, 3)), atol=1e-4)


def test_a_masked_point_is_pushed_out() -> None:
    """A part without extent, which can rotate freely."""
    shirt = shell(1.03, 800)
    point = int(np.argmax(shirt.vertices[:, 2]))
    bump = 1 + 0.1 * np.exp(-(np.linalg.norm(BODY.vertices - [0, 0, 1], axis=1, keepdims=True) ** 2) / 0.01)
    skin = BODY.with_vertices(BODY.vertices * bump)
    worn = fit_to_shape(BODY, BODY.vertices, skin, [shirt], keep=[np.eye(len(shirt.vertices))[point]]).vertices[0]
    assert SidedSurface.of(skin, 1.0).sides(worn[point : point + 1])[0] > 0


def test_a_masked_patch_keeps_what_is_in_the_skin() -> None:
    """A sole encloses a foot: to push out some of it would push the rest in."""
    shirt = shell(0.995, 800)
    soft, kept = (
        fit_to_shape(BODY, BODY.vertices, BODY, [shirt], keep=keep).vertices[0] for keep in (None, [plate(shirt)])
    )
    chosen = plate(shirt) > 0
    assert np.linalg.norm(soft - shirt.vertices, axis=1)[chosen].min() > 0.003
    assert np.linalg.norm(kept - shirt.vertices, axis=1)[chosen].max() < 0.0015


def test_loose_points_follow_the_body() -> None:
    shirt = shell(1.06)
    loose = Surface(np.concatenate([shirt.vertices, [[0, 0, 1.1]]]), shirt.triangles)
    found = fit_to_shape(BODY, EGG.vertices, EGG, [loose]).vertices[0][-1]
    assert abs(off_egg(found[None])[0] - 0.1) < 0.03


def test_vertices_stretched_more_than_the_body_are_marked() -> None:
    shape = EGG.vertices.copy()
    patch = np.linalg.norm(BODY.vertices - [0, 0, 1], axis=1) < 0.25
    shape[patch] += TURN.apply([0.8, 0, 0]) * SIZE  # as if a match sent the patch to another place
    shirt = shell(1.06)
    carried = fit_to_shape(BODY, shape, EGG, [shirt], stiffness=0)
    stretched = carried.stretched[0]
    assert stretched.any()
    assert (np.linalg.norm(shirt.vertices[stretched] - [0, 0, 1.06], axis=1) < 0.6).all()
    assert not fit_to_shape(BODY, EGG.vertices, EGG, [shirt], stiffness=0).stretched[0].any()


def test_invalid_arguments_are_refused() -> None:
    shirt = shell(1.06)
    with pytest.raises(ValueError, match="There is nothing to fit"):
        fit_to_shape(BODY, EGG.vertices, EGG, [])
    with pytest.raises(ValueError, match="stiffness is 2"):
        fit_to_shape(BODY, EGG.vertices, EGG, [shirt], stiffness=2)
    with pytest.raises(ValueError, match="gap is -1"):
        fit_to_shape(BODY, EGG.vertices, EGG, [shirt], gap=-1)
    with pytest.raises(ValueError, match="'automatic', 'soft', 'rigid'"):
        fit_to_shape(BODY, EGG.vertices, EGG, [shirt], manners=["hard"])  # type: ignore[list-item]
    with pytest.raises(ValueError, match="keep has 2 masks: give one, or None, for each of the 1 objects"):
        fit_to_shape(BODY, EGG.vertices, EGG, [shirt], keep=[None, None])
    for mask in ([1.0], np.full(len(shirt.vertices), 2.0), np.full(len(shirt.vertices), np.nan)):
        with pytest.raises(ValueError, match=r"a mask in keep .* numbers from 0 to 1"):
            fit_to_shape(BODY, EGG.vertices, EGG, [shirt], keep=[mask])
    with pytest.raises(MeshError, match="no point among the 2"):
        Lines([[0, 0, 0], [1, 0, 0]], [[0, 2]])
    with pytest.raises(MeshError, match="not finite"):
        Lines([[0, 0, np.nan]], [])
    with pytest.raises(MeshError, match="no points"):
        Lines([], [])


def test_only_places_that_may_collide_are_tested_again(monkeypatch: pytest.MonkeyPatch) -> None:
    shirt, tested = shell(1.06), list[int]()
    sides = SidedSurface.sides

    def counted(self: SidedSurface, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        tested.append(len(points))
        return sides(self, points)

    monkeypatch.setattr(SidedSurface, "sides", counted)
    shape = EGG.vertices.copy()
    dent = np.linalg.norm(BODY.vertices - [0, 0, 1], axis=1) < 0.3
    shape[dent] = onto_egg(0.9 * BODY.vertices[dent])
    found = fit_to_shape(BODY, shape, EGG, [shirt])
    assert off_egg(found.vertices[0][np.unique(shirt.triangles)]).min() > 0
    _, now, *rounds = tested
    assert rounds
    assert max(rounds) < 0.6 * now
