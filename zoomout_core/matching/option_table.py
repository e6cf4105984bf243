# SPDX-License-Identifier: GPL-3.0-or-later
"""The options of a match, one row each: the command line, Blender, MeshLab and `docs/options.md` are made from these.

A row whose name is a field of `MatchOptions` needs nothing else. Each interface turns rows into its own kind of option:
`command_options.py`, `blender_addon/properties/option_property.py` and `meshlab_filter/filters/match_parameters.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from zoomout_core.matching.options import MAX_ANGLE, MAX_DISTANCE, PARTIAL


class Interface(Enum):
    """Where users set options."""

    COMMAND_LINE = "Command line"
    BLENDER = "Blender"
    MESHLAB = "MeshLab"


class Kind(Enum):
    """The type of an option's values; the value of a member describes them in the documentation."""

    START = "choice, or map.npz"  # the file on the command line alone
    CHOICE = "choice"
    FLAG = "on or off"
    COUNT = "whole number"
    NUMBER = "number"
    ANGLE = "degrees"
    LANDMARKS = "file"
    MAP = "map.npz"
    DIRECTIONS = "X,Y,Z"


# The starts that Blender offers, and MeshLab's "given". "nearest" alone is not refined, and has options of its own.
STARTS = ("auto", "landmarks", "proximity", "nearest", "same_order", "file", "given")
REFINED = tuple(start for start in STARTS if start != "nearest")


@dataclass(frozen=True)
class Choice:
    """One value of an option."""

    name: str  # the value; Blender has it in capitals
    help: str  # a sentence without a full stop, as all texts here: Blender adds it
    label: str = ""  # in Blender
    interfaces: tuple[Interface, ...] = tuple(Interface)  # that offer it


@dataclass(frozen=True)
class Option:
    """One option of a match."""

    name: str  # as in Python, in Blender and in MeshLab
    kind: Kind  # of its values
    default: Any  # its value where none is given
    help: str  # what happens and when to use it, without a full stop at the end
    # That offer it. `python -m meshlab_filter transfer` hands the options of the command line to a filter, so those of
    # a match need MeshLab, too.
    interfaces: tuple[Interface, ...] = tuple(Interface)
    label: str = ""  # in Blender
    flag: str = ""  # on the command line, where it is not the name
    choices: tuple[Choice, ...] = ()  # the values of a choice
    minimum: float | None = None  # of a number
    maximum: float | None = None  # of a number
    soft_maximum: float | None = None  # end of Blender's slider
    starts: tuple[str, ...] = REFINED  # values of `initial` that use the option
    panel: str = "Advanced"  # of Blender's sidebar. "Hints" and "Advanced" show their rows by themselves.

    def name_in(self, interface: Interface) -> str:
        """The option's name in an interface."""
        if interface is Interface.COMMAND_LINE:
            return self.flag or "--" + self.name.replace("_", "-")
        return self.label if interface is Interface.BLENDER else self.name

    def choices_in(self, interface: Interface) -> tuple[Choice, ...]:
        """The choices that an interface offers."""
        return tuple(choice for choice in self.choices if interface in choice.interfaces)

    def interfaces_of(self, choice: Choice) -> tuple[Interface, ...]:
        """The interfaces that offer a choice."""
        return tuple(interface for interface in choice.interfaces if interface in self.interfaces)


BLENDER = (Interface.BLENDER,)
COMMAND_LINE = (Interface.COMMAND_LINE,)
MESHLAB = (Interface.MESHLAB,)
FILES = COMMAND_LINE + MESHLAB


def _hint(name: str, label: str, default: bool, text: str) -> Option:
    """Evidence on the map that Blender finds by itself, and that can be switched off."""
    return Option(name, Kind.FLAG, default, text, BLENDER, label, starts=("auto",), panel="Hints")


# The initial map, and evidence on it.
MATCHING = (
    Option(
        "initial",
        Kind.START,
        "auto",
        "How to find the match",
        label="Method",
        choices=(
            Choice("auto", "From the shapes alone; poses and placements may differ", "Automatic"),
            Choice("landmarks", "From the landmarks, for shapes that alone lead to a wrong match", "Landmarks"),
            Choice("proximity", "From the nearest points in space, for meshes that overlap", "Nearest Points"),
            Choice(
                "nearest",
                "Each vertex takes the nearest point if it is close and faces the same way; the others are filled in. "
                "For clothes, in the pose of the body that wears them",
                "Clothes on a Body",
                BLENDER,
            ),
            Choice(
                "same_order",
                "Vertex by vertex, for meshes with the same vertices in the same order, such as a sculpted copy",
                "Same Order",
                BLENDER,
            ),
            Choice("file", "From a map that `zoomout match` wrote for these two meshes", "From File", BLENDER),
            Choice("given", "From `initial_map`", interfaces=MESHLAB),
        ),
        starts=STARTS,
        panel="Match",
    ),
    Option("map_file", Kind.MAP, "", "Map file (.npz) to start from", BLENDER, "Map", starts=("file",), panel="Match"),
    Option(
        "landmarks",
        Kind.LANDMARKS,
        None,
        "Corresponding places, one pair a line: a source vertex and a target vertex, counted from 0, or the six "
        "coordinates of a point on the source and of one on the target",
        FILES,
    ),
    Option(
        "exact_landmarks",
        Kind.FLAG,
        False,
        "Bend the match so that each landmark lands exactly on its partner; otherwise landmarks only attract it",
        label="Hit Exactly",
        panel="Landmarks",
    ),
    _hint(
        "use_landmarks",
        "Landmarks",
        True,
        "Landmarks on both objects mark corresponding places; a single pair tells left from right",
    ),
    _hint(
        "names",
        "Names",
        True,
        "Vertex groups and materials of the same name mark corresponding places. "
        "Turn this off if names mean different things on the two meshes",
    ),
    _hint("same_up", "Same Up Axis", False, "Both objects stand upright along the scene's Z axis"),
    _hint(
        "from_last",
        "Last Match",
        False,
        "The previous match of these two objects is approximately right. Use this after a small change of options",
    ),
    Option(
        "common_axes",
        Kind.DIRECTIONS,
        None,
        "Direction in which both meshes are oriented alike, such as the up axis: x, -x, y, -y, z, -z or X,Y,Z",
        FILES,
        flag="--common-axis",
    ),
    Option(
        "upright",
        Kind.FLAG,
        True,
        "Both meshes usually stand upright, with Y or Z up, which decides between matches that fit equally well. "
        "Turn this off if one of them may be rotated",
        label="Upright",
        starts=("auto", "landmarks"),
        panel="Hints",
    ),
    Option(
        "earlier_map",
        Kind.MAP,
        None,
        "Map (.npz) of these meshes that `zoomout match` wrote and that is approximately right. "
        "It is evidence, whereas `--initial` starts from it alone",
        COMMAND_LINE,
    ),
    Option(
        "initial_map",
        Kind.MAP,
        None,
        "Earlier map, or the .npz file that `zoomout match` wrote: the start if `initial` is given, otherwise evidence",
        MESHLAB,
    ),
    Option(
        "partial",
        Kind.CHOICE,
        "auto",
        "Whether one mesh is tried as a part of the other if they do not match as wholes",
        FILES,
        choices=(
            Choice(PARTIAL[0], "Try it if something may be missing at a border"),
            Choice(PARTIAL[1], "Both meshes are whole"),
        ),
    ),
)

# How finely meshes are analysed: these options are also those of symmetries.
ACCURACY = (
    Option(
        "detail",
        Kind.CHOICE,
        "balanced",
        "How small the features are that are matched; more detail takes longer",
        label="Detail",
        choices=(
            Choice("fast", "Quick preview, and enough for coarse meshes", "Fast"),
            Choice("balanced", "Fine enough for most characters", "Balanced"),
            Choice("fine", "Follows fingers and wrinkles more closely, and takes several times as long", "Fine"),
            Choice("full", "Matches meshes at full size, which takes many times as long", interfaces=FILES),
        ),
        panel="Match",
    ),
    Option(
        "k_final",
        Kind.COUNT,
        0,
        "Number of eigenfunctions that the match is refined to; more follow smaller features but take longer, "
        "and 0 leaves the number to Detail",
        BLENDER,
        "Map Resolution",
        minimum=0,
        maximum=1000,
        soft_maximum=300,
    ),
    Option("seed", Kind.COUNT, 0, "Random seed of the eigensolver", FILES, minimum=0),
)

# Options of nearest points, with initial="nearest".
NEAREST = (
    Option(
        "max_distance",
        Kind.NUMBER,
        MAX_DISTANCE,
        "Largest distance to the nearest point, divided by the square root of the source's area, "
        "which is about 1.4 m for a human",
        COMMAND_LINE + BLENDER,
        "Distance",
        minimum=1e-3,
        soft_maximum=0.5,
        starts=("nearest",),
    ),
    Option(
        "max_angle",
        Kind.ANGLE,
        MAX_ANGLE,
        "Largest angle between the normals of a vertex and of its nearest point",
        COMMAND_LINE + BLENDER,
        "Angle",
        minimum=0,
        maximum=180,
        starts=("nearest",),
    ),
    Option(
        "either_side",
        Kind.FLAG,
        False,
        "Also accept normals that oppose each other, for clothes with an inner side of their own",
        COMMAND_LINE + BLENDER,
        "Either Side",
        starts=("nearest",),
    ),
)

# Options of the transfer along a match.
RESULT = (
    Option(
        "candidate",
        Kind.COUNT,
        0,
        "Which of the maps found to use, counted from 0; try 1 if left and right are swapped",
        FILES,
        minimum=0,
    ),
)

OPTIONS = {option.name: option for option in (*MATCHING, *ACCURACY, *NEAREST, *RESULT)}


def select_options(options: Sequence[Option], interface: Interface) -> tuple[Option, ...]:
    """The options that an interface offers."""
    return tuple(option for option in options if interface in option.interfaces)
