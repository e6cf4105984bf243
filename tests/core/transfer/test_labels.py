# SPDX-License-Identifier: GPL-3.0-or-later
"""Labels are chosen by vote, never mixed, and their borders are as short as the votes allow."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from transfer_meshes import Sheet, identity, sheet, torus, true_map

from zoomout_core.mesh.triangles import edge_lengths
from zoomout_core.transfer import Attribute, Domain, Kind, potts, transfer
from zoomout_core.transfer.cut_mesh import adjacent_edges
from zoomout_core.transfer.potts import Candidates, elect, tally

GRID = (60, 40)


@pytest.fixture(scope="module")
def source() -> Sheet:
    return sheet(torus, *GRID)


@pytest.fixture(scope="module")
def target() -> Sheet:
    return sheet(torus, 49, 31, jitter=0.2, twist=0.05, sides=3, seed=1)


def transfer_labels(
    source: Sheet, target: Sheet, domain: Domain, values: np.ndarray, kind: Kind = Kind.LABEL
) -> np.ndarray:
    surface_map = true_map(source, *GRID, target.parameters)
    return transfer(Attribute("x", domain, kind, values), surface_map, source.surface, target.surface).values


LABELS = {
    "bytes": np.array([-100, 3, 100], dtype=np.int8),
    "wide integers": np.array([2**62 + 1, 2**62 + 3, -5]),
    "strings": np.array(["a", "boot", "glove left"]),
    "objects": np.array(["a", "boot", "glove left"], dtype=object),
    "pairs": np.array([[1, 2], [1, 3], [2, 2]], dtype=np.int32),
}


@pytest.mark.parametrize("labels", LABELS)
@pytest.mark.parametrize("domain", [Domain.POINT, Domain.CORNER, Domain.FACE])
def test_labels_keep_type_and_set_and_the_identity_keeps_each(
    source: Sheet, target: Sheet, labels: str, domain: Domain
) -> None:
    surface = source.surface
    count = {Domain.POINT: len(surface.vertices), Domain.CORNER: len(surface.corner_vertex)}.get(
        domain, len(surface.face_start) - 1
    )
    values = LABELS[labels][np.random.default_rng(0).integers(0, 3, count)]
    result = transfer_labels(source, target, domain, values)
    assert result.dtype == values.dtype
    assert {str(value) for value in result} == {str(value) for value in LABELS[labels]}
    same = transfer(Attribute("x", domain, Kind.LABEL, values), identity(surface), surface, surface).values
    assert (same == values).all()


def test_a_vertex_takes_the_label_with_the_largest_weight(source: Sheet, target: Sheet) -> None:
    values = np.random.default_rng(0).integers(0, 3, len(source.surface.vertices))
    surface_map = true_map(source, *GRID, target.parameters)
    result = transfer_labels(source, target, Domain.POINT, values)
    corners = values[source.surface.triangles[surface_map.triangle]]
    for label, near, weights in zip(result, corners, surface_map.barycentric, strict=True):
        votes: Counter[int] = Counter()
        for value, weight in zip(near.tolist(), weights.tolist(), strict=True):
            votes[value] += weight
        assert votes[label] >= max(votes.values()) - 1e-12


def test_booleans_switch_at_one_half(source: Sheet, target: Sheet) -> None:
    values = np.random.default_rng(0).random(len(source.surface.vertices)) < 0.5
    surface_map = true_map(source, *GRID, target.parameters)
    result = transfer_labels(source, target, Domain.POINT, values, Kind.BOOLEAN)
    part = surface_map.interpolate(values.astype(float))
    clear = np.abs(part - 0.5) > 1e-9
    assert result.dtype == bool
    assert (result[clear] == (part > 0.5)[clear]).all()


def test_face_and_corner_labels_stay_on_their_side(source: Sheet) -> None:
    aligned = sheet(torus, 3 * GRID[0], 3 * GRID[1], sides=3)
    values = np.random.default_rng(0).integers(0, 50, len(source.surface.face_start) - 1)
    column, row = np.floor(aligned.middles * GRID).astype(int).T
    truth = values[column % GRID[0] * GRID[1] + row % GRID[1]]
    assert (transfer_labels(source, aligned, Domain.FACE, values) == truth).all()
    corner = transfer_labels(source, aligned, Domain.CORNER, values[source.surface.corner_face])
    assert (corner == truth[aligned.surface.corner_face]).all()


def test_faces_take_their_majority_label_with_short_borders(
    source: Sheet, target: Sheet, monkeypatch: pytest.MonkeyPatch
) -> None:
    stripe = np.floor(source.middles[:, 0] * 4).astype(int)
    first, second = adjacent_edges(target.surface)
    face = target.surface.corner_face
    whole = np.ptp(np.floor(target.corners[:, 0] * 4).reshape(-1, 3), axis=1) == 0
    middle = np.floor(target.middles[:, 0] * 4).astype(int) % 4

    def border_length() -> float:
        result = transfer_labels(source, target, Domain.FACE, stripe)
        assert (result[whole] == middle[whole]).all()
        border = result[face[first[:, 0]]] != result[face[second[:, 0]]]
        return float(edge_lengths(target.surface.vertices[target.surface.corner_vertex], first)[border].sum())

    smoothed = border_length()
    monkeypatch.setattr(potts, "VOTE_WEIGHT", 1e9)
    by_vote_alone = border_length()
    rings = 4 * 2 * np.pi  # four circles of radius one
    assert smoothed - rings < 0.6 * (by_vote_alone - rings)


def test_neighbours_overrule_a_narrow_vote_but_not_a_clear_one() -> None:
    # A strip of faces with unit edges: all vote 0, but every tenth votes 1 by a narrow or a clear majority.
    count = 5000
    face = np.repeat(np.arange(count), 2)
    odd = np.arange(count) % 10 == 5
    for share, expected in ((0.55, 0), (0.95, 1)):
        votes = np.where(odd, share, 0.1)
        owner, code = face, np.tile([0, 1], count)
        candidates, label = tally(owner, code, np.stack([1 - votes, votes], axis=1).ravel())
        assert candidates.share.reshape(-1, 2)[:, 1] == pytest.approx(votes)
        _, first, second = candidates.pairs(np.arange(count - 1), np.arange(1, count))
        chosen = elect(
            candidates, np.full(count, 3.0), first, second, np.ones(len(first)), label[first] == label[second]
        )
        assert (label[chosen][odd] == expected).all()
        assert (label[chosen][~odd] == 0).all()


def test_elections_never_increase_the_cost() -> None:
    random = np.random.default_rng(0)
    side = 60
    number = np.arange(side * side).reshape(side, side)
    pairs = np.concatenate(
        [
            np.stack([number[:-1].ravel(), number[1:].ravel()]),
            np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()]),
        ],
        axis=1,
    )
    face = np.repeat(np.arange(side * side), 3)
    share = random.dirichlet([1, 1, 1], side * side).ravel()
    candidates = Candidates(face, share)
    edge, first, second = candidates.pairs(*pairs)
    label = np.arange(len(face)) % 3
    length = random.uniform(0.5, 1.5, pairs.shape[1])

    def cost(chosen: np.ndarray) -> float:
        border = length[label[chosen[pairs[0]]] != label[chosen[pairs[1]]]].sum()
        return float(border - 4 * share[chosen].sum())

    chosen = elect(candidates, np.full(side * side, 4.0), first, second, length[edge], label[first] == label[second])
    assert (face[chosen] == np.arange(side * side)).all()
    alone = 3 * np.arange(side * side) + share.reshape(-1, 3).argmax(axis=1)
    assert cost(chosen) < cost(alone)
    for k in range(3):  # changing a single face gains nothing
        for i in random.choice(side * side, 200, replace=False):
            other = chosen.copy()
            other[i] = 3 * i + k
            assert cost(other) >= cost(chosen) - 1e-6
