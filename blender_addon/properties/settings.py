# SPDX-License-Identifier: GPL-3.0-or-later
"""The settings of a scene, which are the defaults of operators' options.

Blender needs evaluated property annotations, so this module does not postpone them.
"""

from bpy.props import BoolProperty, PointerProperty, StringProperty
from bpy.types import Object, Operator, PropertyGroup

from .bake import BakeOptions
from .collections import CollectionSettings
from .dress import DressCollection, DressOptions
from .landmarks import LandmarkSettings
from .library import FoundSettings, LibrarySettings
from .lods import LevelOptions
from .match import MatchOptions, RedoOptions
from .once import ONCE
from .symmetry import ZOOMOUT_PG_symmetry
from .transfer import BindChoice, BindOptions, BindView, BlendOptions, TransferOptions
from .wrap import WrapOptions


class SourceName:
    """Which object an operator takes as the source."""

    source: StringProperty(
        name="Source",
        description=(
            "Name of the source object; if empty, the one chosen in the sidebar, otherwise the mesh selected besides "
            "the active one"
        ),
        options=ONCE,
    )


class OwnSources:
    """Whether an operator takes a source for each target."""

    own_sources: BoolProperty(
        name="Matched Sources",
        description=(
            "Transfer to each target from the source that it was matched with, ignoring the chosen or selected source"
        ),
        default=False,
        options=ONCE,
    )


def _may_be_source(settings: PropertyGroup, obj: Object) -> bool:
    return obj.type == "MESH"


class ZOOMOUT_PG_settings(
    MatchOptions,
    RedoOptions,
    TransferOptions,
    BlendOptions,
    BindChoice,
    BindOptions,
    BindView,
    WrapOptions,
    BakeOptions,
    LevelOptions,
    DressOptions,
    DressCollection,
    LandmarkSettings,
    CollectionSettings,
    LibrarySettings,
    FoundSettings,
    PropertyGroup,
):
    """The scene's settings."""

    source: PointerProperty(
        name="Source",
        description=(
            "Mesh to copy data from; the active mesh receives the data. If none is chosen, the mesh selected besides "
            "the active one is used"
        ),
        type=Object,
        poll=_may_be_source,
    )
    symmetry: PointerProperty(name="Symmetry", description="Settings of the symmetry tools", type=ZOOMOUT_PG_symmetry)


def take_settings(operator: Operator, settings: PropertyGroup) -> None:
    """Set the options of an operator that its caller did not set from a group of the scene's settings."""
    for options in type(settings).__bases__:
        for name in options.__annotations__ if isinstance(operator, options) else ():
            if not operator.properties.is_property_set(name):
                setattr(operator, name, getattr(settings, name))
