# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of options agrees with the library, and its interfaces keep their names."""

from __future__ import annotations

from dataclasses import fields
from inspect import signature

import click
import pytest

from zoomout_core.cli import main
from zoomout_core.matching.option_table import (
    ACCURACY,
    MATCHING,
    NEAREST,
    OPTIONS,
    STARTS,
    Interface,
    Kind,
    Option,
    select_options,
)
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.presets import DETAIL
from zoomout_core.matching.proximity import match_by_proximity

LIBRARY = {field.name: field.default for field in fields(MatchOptions)}
PROXIMITY = {name: each.default for name, each in signature(match_by_proximity).parameters.items()}
# Arguments of `match` with another form in interfaces: 0 eigenfunctions means the number of the detail level.
OTHERWISE = {"k_final"}


@pytest.mark.parametrize("option", OPTIONS.values(), ids=list(OPTIONS))
def test_defaults_are_those_of_the_library(option: Option) -> None:
    library = PROXIMITY if option in NEAREST else LIBRARY
    if option.name in library and option.name not in OTHERWISE:
        assert option.default == library[option.name]


@pytest.mark.parametrize("option", OPTIONS.values(), ids=list(OPTIONS))
def test_row_has_all_that_its_interfaces_show(option: Option) -> None:
    assert option.interfaces
    assert set(option.starts) <= set(STARTS)
    assert (Interface.BLENDER in option.interfaces) == bool(option.label)
    assert bool(option.choices) == (option.kind in (Kind.START, Kind.CHOICE))
    assert all(
        choice.label for choice in option.choices_in(Interface.BLENDER) if Interface.BLENDER in option.interfaces
    )
    for text in (option.help, *(choice.help for choice in option.choices)):
        assert text[0].isupper()
        assert not text.endswith(".")


def test_filters_accept_the_options_of_their_command_line() -> None:
    flags = {option.name for option in select_options((*MATCHING, *ACCURACY), Interface.COMMAND_LINE)}
    parameters = {option.name for option in select_options((*MATCHING, *ACCURACY), Interface.MESHLAB)}
    assert flags - parameters == {"earlier_map"}  # `read_options` turns it into the initial map


def test_detail_offers_all_presets() -> None:
    assert [choice.name for choice in OPTIONS["detail"].choices] == list(DETAIL)


def test_flags_keep_their_names_and_defaults() -> None:
    match, transfer = (main.get_command(click.Context(main), name) for name in ("match", "transfer"))
    params = {option.opts[-1]: option for option in match.params if isinstance(option, click.Option)}
    defaults = {
        "--initial": "auto",
        "--candidate": 0,
        "--exact-landmarks": False,
        "--upright": True,
        "--partial": "auto",
        "--detail": "balanced",
        "--seed": 0,
        "--max-distance": 0.08,
        "--max-angle": 30.0,
        "--either-side": False,
    }
    context = click.Context(match)
    assert {flag: params[flag].get_default(context) for flag in defaults} == defaults
    without = {"--landmarks", "--earlier-map", "--common-axis"}
    own = {"--output", "--in-place", "--cache", "--json", "--first-look", "--quiet"}
    assert set(params) == {*defaults, *without, *own}
    assert "--candidate" in {name for option in transfer.params for name in option.opts}
