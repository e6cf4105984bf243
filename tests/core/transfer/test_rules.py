# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes that can be transferred, and the errors for others."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_array
from transfer_meshes import Sheet, identity, sheet, torus

from zoomout_core.mesh.errors import MeshError
from zoomout_core.transfer import RULES, Attribute, Domain, Kind, transfer


@pytest.fixture(scope="module")
def mesh() -> Sheet:
    return sheet(torus, 60, 40)


VALUES = {
    Kind.SCALAR: lambda count: np.arange(count, dtype=float),
    Kind.VECTOR: lambda count: np.zeros((count, 3)),
    Kind.DIRECTION: lambda count: np.ones((count, 3)),
    Kind.NORMAL: lambda count: np.ones((count, 3), dtype=np.float32),
    Kind.QUATERNION: lambda count: np.tile([1.0, 0, 0, 0], (count, 1)),
    Kind.MATRIX: lambda count: np.tile(np.eye(4).ravel(), (count, 1)),
    Kind.MARK: lambda count: (np.arange(count) % 9 == 0).astype(float),
    Kind.COLOR: lambda count: np.zeros((count, 4), dtype=np.float32),
    Kind.UV: lambda count: np.zeros((count, 2)),
    Kind.LABEL: lambda count: np.arange(count),
    Kind.BOOLEAN: lambda count: np.arange(count) % 2 == 0,
    Kind.WEIGHT: lambda count: csr_array(np.full((count, 2), 0.5)),
    Kind.OFFSET: lambda count: np.full((count, 2, 3), 0.1),
}


def refusal_of(mesh: Sheet, attribute: Attribute) -> str:
    with pytest.raises(MeshError) as error:
        transfer(attribute, identity(mesh.surface), mesh.surface, mesh.surface)
    message = str(error.value)
    assert message.endswith(".")
    assert "\n" not in message
    return message


@pytest.mark.parametrize("kind", RULES)
def test_every_rule_checks_domains_and_counts(mesh: Sheet, kind: Kind) -> None:
    surface = mesh.surface
    counts = {Domain.POINT: 2400, Domain.EDGE: 4800, Domain.FACE: 2400, Domain.CORNER: 9600}
    for domain, count in counts.items():
        attribute = Attribute("thing", domain, kind, VALUES[kind](count))
        if domain in RULES[kind].domains:
            result = transfer(attribute, identity(surface), surface, surface)
            assert result.values.shape == attribute.values.shape
            short = Attribute("thing", domain, kind, VALUES[kind](count - 1))
            message = refusal_of(mesh, short)
            assert str(count) in message
            assert str(count - 1) in message
        else:
            assert "give one for each" in refusal_of(mesh, attribute)


def test_kinds_without_a_rule_are_refused_with_a_list_of_kinds(mesh: Sheet, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(RULES, Kind.MARK)
    message = refusal_of(mesh, Attribute("thing", Domain.POINT, Kind.MARK, np.zeros(2400)))
    assert message.startswith("'thing' is of the kind mark, ")
    able = message.partition("these can: ")[2].removesuffix(".").split(", ")
    assert able == [kind.name.lower() for kind in Kind if kind is not Kind.MARK]


@pytest.mark.parametrize(
    ("domain", "kind", "values"),
    [
        (Domain.POINT, Kind.SCALAR, np.zeros((2400, 2))),
        (Domain.POINT, Kind.SCALAR, np.full(2400, "a")),
        (Domain.POINT, Kind.VECTOR, np.zeros(2400)),
        (Domain.POINT, Kind.COLOR, np.zeros((2400, 4), dtype=np.uint8)),
        (Domain.CORNER, Kind.UV, np.zeros((9600, 3))),
        (Domain.POINT, Kind.COLOR, np.zeros((2400, 2))),
        (Domain.POINT, Kind.COLOR, np.zeros((2400, 5))),
        (Domain.CORNER, Kind.UV, np.zeros(9600)),
        (Domain.POINT, Kind.DIRECTION, np.zeros((2400, 2))),
        (Domain.POINT, Kind.DIRECTION, np.zeros((2400, 4))),
        (Domain.POINT, Kind.NORMAL, np.zeros((2400, 2))),
        (Domain.POINT, Kind.NORMAL, np.zeros((2400, 4))),
        (Domain.POINT, Kind.QUATERNION, np.zeros((2400, 3))),
        (Domain.POINT, Kind.QUATERNION, np.zeros((2400, 5))),
        (Domain.FACE, Kind.MATRIX, np.zeros((2400, 4))),
        (Domain.FACE, Kind.MATRIX, np.zeros((2400, 15))),
        (Domain.FACE, Kind.MATRIX, np.zeros((2400, 17))),
        (Domain.POINT, Kind.MARK, np.zeros(2400, dtype=int)),
        (Domain.POINT, Kind.LABEL, np.zeros(2400)),
        (Domain.POINT, Kind.BOOLEAN, np.zeros(2400, dtype=int)),
        (Domain.POINT, Kind.WEIGHT, np.zeros((2400, 3))),
        (Domain.POINT, Kind.SCALAR, csr_array(np.zeros((2400, 1)))),
    ],
)
def test_values_of_the_wrong_shape_or_type_are_refused(mesh: Sheet, domain: Domain, kind: Kind, values: object) -> None:
    message = refusal_of(mesh, Attribute("thing", domain, kind, values))
    assert RULES[kind].meaning in message


def test_attributes_without_finite_values_are_refused(mesh: Sheet) -> None:
    uv = np.full((9600, 2), np.nan)
    assert "no finite values" in refusal_of(mesh, Attribute("thing", Domain.CORNER, Kind.UV, uv))
    weights = csr_array(np.full((2400, 2), np.inf))
    assert "no finite values" in refusal_of(mesh, Attribute("thing", Domain.POINT, Kind.WEIGHT, weights))


def test_rules_declare_mixable_and_mirrorable_kinds() -> None:
    # Directions rotate, labels have no mean, and UVs may be on different islands: they have their own methods.
    mixable = {kind for kind, rule in RULES.items() if rule.mixable}
    assert mixable == {Kind.SCALAR, Kind.VECTOR, Kind.COLOR, Kind.WEIGHT, Kind.OFFSET}
    mirrorable = {kind for kind, rule in RULES.items() if rule.mirrorable}
    assert mirrorable == {Kind.SCALAR, Kind.VECTOR, Kind.COLOR, Kind.WEIGHT, Kind.BOOLEAN, Kind.MARK}


def test_a_map_between_other_surfaces_is_refused(mesh: Sheet) -> None:
    other = sheet(torus, 50, 40)
    attribute = Attribute("thing", Domain.POINT, Kind.SCALAR, np.zeros(2400))
    with pytest.raises(MeshError, match="match these two surfaces again"):
        transfer(attribute, identity(mesh.surface), mesh.surface, other.surface)
    with pytest.raises(MeshError, match="match these two surfaces again"):
        transfer(attribute, identity(other.surface), mesh.surface, other.surface)


def test_notes_of_an_attribute_are_kept(mesh: Sheet) -> None:
    for kind, domain in ((Kind.SCALAR, Domain.POINT), (Kind.UV, Domain.CORNER)):
        values = VALUES[kind](2400 if domain is Domain.POINT else 9600)
        attribute = Attribute("thing", domain, kind, values, notes=("It was painted by hand.",))
        result = transfer(attribute, identity(mesh.surface), mesh.surface, mesh.surface)
        assert result.notes[0] == "It was painted by hand."


@pytest.mark.filterwarnings("error")
def test_values_of_single_precision_are_checked_without_warnings(mesh):
    single = Attribute("single", Domain.POINT, Kind.SCALAR, np.ones(len(mesh.surface.vertices), dtype=np.float32))
    np.testing.assert_array_equal(transfer(single, identity(mesh.surface), mesh.surface, mesh.surface).values, 1)
