# SPDX-License-Identifier: GPL-3.0-or-later
"""Parameters that several filters share, and those of a match, from the option table of the core."""

from __future__ import annotations

from collections.abc import Sequence

from meshlab_filter.parameters import CHOICE, COUNT, DATA, MESH, NUMBER, SWITCH, TEXT, Parameter
from zoomout_core.matching import option_table
from zoomout_core.matching.option_table import Interface, Kind, Option, select_options

SOURCE = Parameter("sourcemesh", MESH, 0, "The mesh that gives.")
TARGET = Parameter("targetmesh", MESH, 1, "The mesh that receives.")
STORED = Parameter(
    "correspondence",
    TEXT,
    "correspondence",
    "The name under which compute_correspondence_by_zoomout stored it on the target.",
)
STORED_OR_NEW = Parameter(
    "correspondence",
    TEXT,
    "",
    "The name under which compute_correspondence_by_zoomout stored it on the target; empty: find one.",
)
# Kinds of options in the core's table that have their own parameter type; all others take arrays or files.
TYPES = {
    Kind.START: CHOICE,
    Kind.CHOICE: CHOICE,
    Kind.FLAG: SWITCH,
    Kind.COUNT: COUNT,
    Kind.NUMBER: NUMBER,
    Kind.ANGLE: NUMBER,
}


def parameters_of(options: Sequence[Option]) -> tuple[Parameter, ...]:
    """The parameters for rows of the option table."""
    return tuple(_parameter(option) for option in select_options(options, Interface.MESHLAB))


def _parameter(option: Option) -> Parameter:
    choices = tuple(choice.name for choice in option.choices_in(Interface.MESHLAB))
    unit = ", in degrees" if option.kind is Kind.ANGLE else ""
    return Parameter(option.name, TYPES.get(option.kind, DATA), option.default, f"{option.help}{unit}.", choices)


ACCURACY = parameters_of(option_table.ACCURACY)
MATCHING = parameters_of((*option_table.MATCHING, *option_table.ACCURACY, *option_table.RESULT))
