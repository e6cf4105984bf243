# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender properties for rows of the core's table of options."""

from __future__ import annotations

import math
from typing import Any

from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from zoomout_core.matching.option_table import Interface, Kind, Option

from ..translations import CONTEXT
from .once import ONCE


def option_property(option: Option) -> Any:
    """The property for a row of the table."""
    named = {"name": option.label, "description": option.help, "options": ONCE}
    ends = {"min": option.minimum, "max": option.maximum, "soft_max": option.soft_maximum}
    limits = {name: end for name, end in ends.items() if end is not None}
    if option.kind in (Kind.START, Kind.CHOICE):
        items = tuple(
            (choice.name.upper(), choice.label, choice.help) for choice in option.choices_in(Interface.BLENDER)
        )
        return EnumProperty(**named, items=items, default=option.default.upper(), translation_context=CONTEXT)
    if option.kind is Kind.FLAG:
        return BoolProperty(**named, default=option.default)
    if option.kind is Kind.COUNT:
        return IntProperty(**named, **limits, default=option.default)
    if option.kind is Kind.NUMBER:
        return FloatProperty(**named, **limits, default=option.default)
    if option.kind is Kind.ANGLE:
        radians = {name: math.radians(end) for name, end in limits.items()}
        return FloatProperty(**named, **radians, default=math.radians(option.default), subtype="ANGLE")
    if option.kind is Kind.MAP:
        return StringProperty(**named, subtype="FILE_PATH")
    raise ValueError(f"{option.name}: Blender has no property for {option.kind}.")


def argument(option: Option, value: Any) -> Any:
    """The argument in Python for the value of such a property."""
    if option.kind in (Kind.START, Kind.CHOICE):
        return value.lower()
    # In single precision, 180 degrees come back as slightly more.
    return round(math.degrees(value), 3) if option.kind is Kind.ANGLE else value
