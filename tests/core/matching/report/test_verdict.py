# SPDX-License-Identifier: GPL-3.0-or-later
"""One verdict on a map: its level, its reason and advice."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from creatures import creature

import zoomout_core as zo
from zoomout_core.matching.report.part_report import name_components
from zoomout_core.matching.report.verdict import AMBER, GREEN, RED, VERDICT, Faults, judge, worst
from zoomout_core.mesh.named_parts import name_parts
from zoomout_core.tuning import retune

pytestmark = pytest.mark.usefixtures("few_candidates")


@pytest.mark.parametrize(
    ("changed", "level", "reason"),
    [
        ({}, GREEN, "right as a whole (99% certain)."),
        ({"certainty": 0.7}, AMBER, "may be wrong"),
        ({"certainty": 0.1}, RED, "probably wrong"),
        ({"torn": 0.01}, GREEN, "certain"),
        ({"torn": 0.05}, AMBER, "tears apart 5.0%"),
        ({"certainty": 0.8, "torn": 0.05}, AMBER, "tears apart 5.0%"),
        ({"certainty": 0.7, "torn": 0.05}, AMBER, "may be wrong"),
        ({"torn": 0.3}, RED, "tears apart 30%"),
        ({"silent": 0.02}, AMBER, "receives almost nothing"),
        (
            {"certainty": 0.9979, "doubtful": 0.176},
            GREEN,
            "(over 99% certain). On the doubtful 18% of the target, it may be off by several percent",
        ),
        ({"doubtful": 0.004}, GREEN, "(99% certain)."),
        ({"doubtful": 0.6}, AMBER, "60% of the target is doubtful"),
        ({"doubtful": 0.46, "doubtful_vertices": 0.76}, AMBER, "76% of the target's vertices are doubtful"),
        ({"doubtful": 0.6, "doubtful_vertices": 0.7}, AMBER, "60% of the target is doubtful"),
        ({"doubtful": 0.14, "doubtful_vertices": 0.31}, GREEN, "doubtful 14%"),
        ({"alone": 0.05}, GREEN, "certain"),
        ({"mirrored": True}, AMBER, "mirror image"),
        ({"certainty": 0.76, "unplaced": 0.235}, AMBER, "24% of the target has no certain place"),
        ({"certainty": 0.6, "unplaced": 0.235}, AMBER, "may be wrong"),
        ({"alone": 0.4}, AMBER, "no partner"),
    ],
)
def test_worst_fault_decides_the_verdict(changed: dict[str, Any], level: str, reason: str) -> None:
    verdict = judge(changed.pop("certainty", 0.99), Faults(**changed))
    assert verdict.level == level
    assert reason in verdict.sentence
    assert bool(verdict.advice) == (level != GREEN)


def test_advice_for_unknown_places_does_not_mention_sides() -> None:
    assert "parts of the source whose data" in judge(0.76, Faults(unplaced=0.235, silent=0.35)).advice
    assert "doubtful vertices" in judge(0.76, Faults(unplaced=0.235)).advice
    assert "sides are swapped" in judge(0.6, Faults(unplaced=0.235, silent=0.35)).advice


def test_worst_of_several_verdicts_counts() -> None:
    verdicts = [judge(0.99), judge(0.1), judge(0.99, Faults(torn=0.05))]
    assert worst(verdicts) is verdicts[1]
    assert worst(verdicts[::2]) is verdicts[2]


def test_part_without_images_makes_the_verdict_amber() -> None:
    made = creature(400, asymmetry=0.3)
    top = made.surface.vertices[np.argmax(made.surface.vertices[:, 2])]
    lump = zo.Surface(made.surface.vertices * 0.3 + top, made.surface.triangles)
    result = zo.match(zo.Surface.joined([made.surface, lump]), made.surface, k_final=30, samples=120)
    assert 0.03 < result.pair.shares[1] < 0.12
    assert result.arrived[0] > 0.9
    np.testing.assert_array_equal(result.silent, [1])
    assert result.verdict.level == AMBER


def test_part_without_confidence_makes_the_verdict_amber() -> None:
    made = creature(400, asymmetry=0.3)
    top = made.surface.vertices[np.argmax(made.surface.vertices[:, 2])]
    lump = zo.Surface(made.surface.vertices * 0.3 + top, made.surface.triangles)
    both = zo.Surface.joined([made.surface, lump])
    result = zo.match(both, zo.Surface(both.vertices, both.triangles), k_final=30, samples=120)
    assert result.verdict.level == GREEN
    lands = both.components[result.surface_map.vertex] == 1
    doubted = replace(result, confidence=np.where(lands, 0.1, result.confidence))
    np.testing.assert_array_equal(doubted.uncertain, [1])
    assert len(doubted.silent) == 0
    assert doubted.verdict.level == AMBER
    with retune(VERDICT, trusted=0.0):
        assert doubted.verdict.level == GREEN


def test_a_small_part_is_missed_unless_others_of_its_name_arrive() -> None:
    made = creature(400, asymmetry=0.3)
    top = made.surface.vertices[np.argmax(made.surface.vertices[:, 2])]
    source = zo.Surface.joined([made.surface, zo.Surface(made.surface.vertices * 0.05 + top, made.surface.triangles)])
    found = zo.match(source, made.surface, k_final=30, samples=120)
    shares = np.array([0.998, 0.002])
    result = replace(found, pair=replace(found.pair, shares=shares))
    np.testing.assert_array_equal(result.uncertain, [1])
    is_small = source.components[source.triangles[:, 0]] == 1

    def level(materials: list[str], lost: float = 0.002) -> str:
        pair = replace(found.pair, shares=np.array([1 - lost, lost]))
        parts = name_parts(source, ["Hero"], 0, materials, np.where(is_small, 1, 0))
        return name_components(replace(result, pair=pair), parts).verdict.level

    assert result.verdict.level == AMBER
    assert level(["Skin", "Glasses"]) == AMBER
    assert level(["Skin", "Skin"]) == GREEN
    assert level(["Skin", "Skin"], lost=0.02) == AMBER


def test_a_match_of_a_shape_with_itself_is_green() -> None:
    surface = creature(400).surface
    result = zo.match(surface, zo.Surface(surface.vertices, surface.triangles), k_final=30, samples=120)
    assert result.verdict.level == GREEN
    np.testing.assert_array_equal(result.arrived, [1.0])
    assert len(result.silent) == 0
