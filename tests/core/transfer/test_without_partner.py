# SPDX-License-Identifier: GPL-3.0-or-later
"""Target regions without a partner are filled in from their surroundings, for every kind, or left unchanged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_array
from transfer_meshes import Sheet, sheet, torus

from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer import Attribute, Blend, Domain, Kind, map_target, transfer
from zoomout_core.transfer.blend import blend
from zoomout_core.transfer.continuation import extrapolate_map


@dataclass
class Masked:
    """A map with full confidence everywhere, which is wrong where there is no partner."""

    surface_map: SurfaceMap
    confidence: np.ndarray
    has_partner: np.ndarray


@pytest.fixture(scope="module")
def mesh() -> Sheet:
    return sheet(torus, 30, 20, jitter=0.2, sides=4)


@pytest.fixture(scope="module")
def match(mesh: Sheet) -> Masked:
    """The identity, except for a disk in the middle of the parameters that maps to one distant vertex."""
    alone = np.linalg.norm(mesh.parameters - 0.5, axis=1) < 0.15
    elsewhere = np.argmin(np.linalg.norm(mesh.parameters - 0.1, axis=1))
    vertex = np.where(alone, elsewhere, np.arange(len(alone)))
    return Masked(SurfaceMap.from_vertices(vertex, mesh.surface), np.ones(len(alone)), ~alone)


def near(mesh: Sheet) -> np.ndarray:
    """(n,) true around the disk, false at the wrong image."""
    return np.linalg.norm(mesh.parameters - 0.5, axis=1) < 0.3


def values(mesh: Sheet, kind: Kind, domain: Domain) -> Attribute:
    """An attribute with one value around the disk and another at the wrong image."""
    here = near(mesh)
    surface = mesh.surface
    of_face = here[surface.corner_vertex[surface.face_start[:-1]]]
    here = {
        Domain.POINT: here,
        Domain.EDGE: here[surface.edges].all(axis=1),
        Domain.CORNER: here[surface.corner_vertex],
        Domain.FACE: of_face,
    }[domain]
    one = here.astype(float)
    found: dict[Kind, Any] = {
        Kind.SCALAR: one,
        Kind.COLOR: np.column_stack([one, one, one]),
        Kind.LABEL: np.where(here, 7, 3),
        Kind.BOOLEAN: here,
        Kind.UV: np.column_stack([0.2 + 0.6 * one, 0.5 * one]),
        Kind.WEIGHT: csr_array(np.column_stack([one, 1 - one])),
        Kind.OFFSET: np.stack([one, 0 * one, 0 * one], axis=-1)[:, None],
        Kind.QUATERNION: np.column_stack([one, 1 - one, 0 * one, 0 * one]),
        Kind.MARK: one,
    }
    labels = ("near", "far") if kind is Kind.WEIGHT else ("key",) if kind is Kind.OFFSET else ()
    return Attribute("it", domain, kind, found[kind], labels)


KINDS = [
    (Kind.SCALAR, Domain.POINT),
    (Kind.SCALAR, Domain.FACE),
    (Kind.SCALAR, Domain.CORNER),
    (Kind.COLOR, Domain.CORNER),
    (Kind.LABEL, Domain.POINT),
    (Kind.LABEL, Domain.FACE),
    (Kind.LABEL, Domain.CORNER),
    (Kind.BOOLEAN, Domain.POINT),
    (Kind.UV, Domain.CORNER),
    (Kind.WEIGHT, Domain.POINT),
    (Kind.OFFSET, Domain.POINT),
    (Kind.QUATERNION, Domain.POINT),
]


def dense(attribute: Attribute) -> np.ndarray:
    found: Any = attribute.values
    return np.asarray(found.toarray() if attribute.kind is Kind.WEIGHT else found, dtype=float).reshape(
        found.shape[0], -1
    )


def elements(surface: Surface, vertices: np.ndarray, domain: Domain) -> np.ndarray:
    """Which elements of a surface have all corners in a mask of vertices (n,)."""
    if domain is Domain.POINT:
        return vertices
    if domain is Domain.EDGE:
        return vertices[surface.edges].all(axis=1)
    corners = vertices[surface.corner_vertex]
    faces = np.logical_and.reduceat(corners, surface.face_start[:-1])
    return faces if domain is Domain.FACE else faces[surface.corner_face]


@pytest.mark.parametrize(("kind", "domain"), KINDS)
def test_every_kind_is_continued_from_its_surroundings(mesh: Sheet, match: Masked, kind: Kind, domain: Domain) -> None:
    attribute = values(mesh, kind, domain)
    alone = elements(mesh.surface, ~match.has_partner, domain)
    around = np.flatnonzero(near(mesh) & match.has_partner)[0]
    expected = dense(values(mesh, kind, Domain.POINT))[around] if kind is not Kind.UV else [0.8, 0.5]
    got = dense(transfer(attribute, match, mesh.surface, mesh.surface))
    np.testing.assert_allclose(got[alone], np.tile(expected, (alone.sum(), 1)), atol=0.04)
    if kind is Kind.WEIGHT:  # its islands are filled in without a mask, too
        return
    # Without the mask, the disk gets the value at the wrong image.
    blind = Masked(match.surface_map, match.confidence, np.ones_like(match.has_partner))
    wrong = dense(transfer(attribute, blind, mesh.surface, mesh.surface))[alone]
    assert np.abs(wrong - expected).max(axis=1).mean() > 0.5


@pytest.mark.parametrize(("kind", "domain"), [*KINDS, (Kind.MARK, Domain.POINT), (Kind.BOOLEAN, Domain.EDGE)])
def test_every_kind_can_be_left_unchanged(mesh: Sheet, match: Masked, kind: Kind, domain: Domain) -> None:
    attribute = values(mesh, kind, domain)
    alone = elements(mesh.surface, ~match.has_partner, domain)
    received = transfer(attribute, match, mesh.surface, mesh.surface)
    own = received.values * 0 if kind is not Kind.BOOLEAN else np.zeros_like(received.values)
    present = Attribute("it", domain, kind, own, attribute.labels)
    kept = dense(blend(received, present, mesh.surface, Blend(mask=match.has_partner)))
    assert np.abs(kept[alone]).max() == 0
    rest = elements(mesh.surface, match.has_partner, domain)
    np.testing.assert_allclose(kept[rest], dense(received)[rest], atol=1e-6)


def test_map_is_extrapolated_only_within_connected_parts(mesh: Sheet, match: Masked) -> None:
    surface = Surface.joined([mesh.surface, mesh.surface.with_vertices(mesh.surface.vertices + 9)])
    n = len(match.has_partner)
    doubled = SurfaceMap.from_vertices(np.tile(match.surface_map.vertex, 2), mesh.surface)
    has_partner = np.append(match.has_partner, np.zeros(n, dtype=bool))
    found = extrapolate_map(doubled, surface, has_partner)
    np.testing.assert_array_equal(found.triangle[n:], doubled.triangle[n:])
    kept = np.flatnonzero(match.has_partner)
    np.testing.assert_array_equal(found.triangle[kept], doubled.triangle[kept])
    alone = np.flatnonzero(~match.has_partner)
    apart = np.linalg.norm(mesh.surface.vertices[alone, None] - mesh.surface.vertices[kept], axis=2)
    on = np.linalg.norm(mesh.surface.vertices[alone] - found.interpolate(mesh.surface.vertices)[alone], axis=1)
    assert (on <= 1.5 * apart.min(axis=1)).all()
    for everywhere in (np.ones(2 * n, dtype=bool), np.zeros(2 * n, dtype=bool)):
        assert extrapolate_map(doubled, surface, everywhere) is doubled


def test_numbers_are_extrapolated_smoothly(mesh: Sheet, match: Masked) -> None:
    slope = np.sin(2 * np.pi * mesh.parameters[:, 0])
    number = Attribute("it", Domain.POINT, Kind.SCALAR, slope)
    alone = ~match.has_partner
    smooth = transfer(number, match, mesh.surface, mesh.surface).values
    nearest = extrapolate_map(match.surface_map, mesh.surface, match.has_partner).interpolate(slope)
    off = [np.abs(values - slope)[alone].mean() for values in (smooth, nearest)]
    assert off[0] < 0.5 * off[1]
    # Confidence is zero there.
    mapped = map_target(match, mesh.surface, mesh.surface)
    np.testing.assert_array_equal(mapped.confidence, match.has_partner)


def test_mask_of_wrong_length_is_refused(mesh: Sheet, match: Masked) -> None:
    with pytest.raises(MeshError, match="match these two surfaces again"):
        map_target(Masked(match.surface_map, match.confidence, np.ones(3, bool)), mesh.surface, mesh.surface)
