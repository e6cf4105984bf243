# SPDX-License-Identifier: GPL-3.0-or-later
"""Options of a match, from the core's table.

Blender needs evaluated property annotations, so this module does not postpone them.
"""

from typing import Any

from bpy.props import BoolProperty, StringProperty

from zoomout_core.matching.option_table import OPTIONS, Interface, Option, select_options

from .once import ONCE
from .option_property import argument, option_property

OFFERED = select_options(tuple(OPTIONS.values()), Interface.BLENDER)


def options_of_panel(panel: str, initial: str) -> tuple[Option, ...]:
    """The options that a panel shows for a start (`initial`), which is in capitals as in Blender."""
    return tuple(option for option in OFFERED if option.panel == panel and initial.lower() in option.starts)


class MatchOptions:
    """How to match: a property for each option of the core's table that Blender offers."""

    __annotations__ = {option.name: option_property(option) for option in OFFERED}

    def match_options(self) -> dict[str, Any]:
        """The chosen arguments of `services.matching.match.match_objects` that the start uses."""
        chosen = {option.name: argument(option, getattr(self, option.name)) for option in OFFERED}
        return {option.name: chosen[option.name] for option in OFFERED if chosen["initial"] in option.starts}


class RedoOptions:
    """Where to match a target again."""

    redo_group: StringProperty(
        name="Redo Only",
        description=(
            "Match Again replaces the match only in this vertex group of the target, with a smooth transition; if "
            "empty, everywhere"
        ),
        options=ONCE,
    )
    redo_keeps: BoolProperty(
        name="Keep",
        description="Keep the match in the vertex group, and match everything else again",
        default=False,
        options=ONCE,
    )

    def redo_options(self) -> dict[str, Any]:
        """The chosen arguments of `match_objects`."""
        return {"redo_group": self.redo_group, "redo_keeps": self.redo_keeps}


def option_label(name: str) -> str:
    """The label of an argument of `match_objects` in the interface, or its name if it has none."""
    option = MatchOptions.__annotations__.get(name)
    return option.keywords["name"] if option else name
