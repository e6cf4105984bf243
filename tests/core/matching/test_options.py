# SPDX-License-Identifier: GPL-3.0-or-later
"""The options of a match, and the presets."""

from __future__ import annotations

import re
from dataclasses import fields

import numpy as np
import pytest

import zoomout_core as zo
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.preparation.proxy import PROXY
from zoomout_core.matching.presets import DETAIL, resolve_detail

SIZES = {"k_final": 4, "step": 1, "samples": 1, "proxy_vertices": 500}


@pytest.mark.parametrize(("name", "least"), SIZES.items())
def test_sizes_are_whole_numbers_of_at_least_a_minimum(name: str, least: int) -> None:
    for value in (least, np.int64(least), 10**6):
        assert getattr(MatchOptions(**{name: value}), name) == value
    for value in (least - 1, -1, least + 0.5, float(least + 1), str(least + 1), True):
        with pytest.raises(ValueError, match=f"{name} is {value!r}: give a whole number of {least} or more"):
            MatchOptions(**{name: value})


def test_each_preset_is_finer_than_the_one_before_it() -> None:
    assert list(DETAIL) == ["fast", "balanced", "fine", "full"]
    assert all(set(preset) <= {field.name for field in fields(MatchOptions)} for preset in DETAIL.values())
    fast, balanced, fine, full = (MatchOptions(**preset) for preset in DETAIL.values())  # type: ignore[arg-type]
    assert fast.k_final < balanced.k_final < fine.k_final <= full.k_final
    assert fast.samples < balanced.samples < fine.samples < full.samples
    assert fast.proxy_vertices < PROXY.min_vertices < PROXY.max_vertices < fine.proxy_vertices  # type: ignore[operator]
    assert (balanced.proxy_vertices, full.proxy_vertices) == ("auto", None)


def test_size_overrides_the_preset_and_is_clamped() -> None:
    assert resolve_detail() == resolve_detail("balanced", 0) == {}
    assert resolve_detail("fine", seed=3) == DETAIL["fine"] | {"seed": 3}
    assert resolve_detail("fast", 90, samples=40) == {"k_final": 90, "samples": 40, "proxy_vertices": 2000}
    assert MatchOptions(**resolve_detail(k_final=1)).k_final == SIZES["k_final"]


def test_the_help_of_match_describes_each_option() -> None:
    described = set(re.findall(r"(?m)^        (\w+): ", str(zo.match.__doc__)))
    assert {field.name for field in fields(zo.MatchOptions)} <= described
    assert "given" not in described
