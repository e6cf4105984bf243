"""Transfer of attributes from a source surface to a target, along a map between them."""

from zoomout_core.transfer.attribute import Attribute, Domain, Kind
from zoomout_core.transfer.blend import MODES, Blend, Mode, blend
from zoomout_core.transfer.dressing.dress import (
    Dressed,
    Manner,
    carry,
    carry_steps,
    dress,
    dress_steps,
    shape_of_source_steps,
)
from zoomout_core.transfer.dressing.form import Lines
from zoomout_core.transfer.rules import RULES, Rule, conform, map_target, transfer, transfer_along, transfer_steps
from zoomout_core.transfer.wrapping.wrap import Wrapped, reversed_match, reversed_match_steps, wrap, wrap_steps

__all__ = [
    "MODES",
    "RULES",
    "Attribute",
    "Blend",
    "Domain",
    "Dressed",
    "Kind",
    "Lines",
    "Manner",
    "Mode",
    "Rule",
    "Wrapped",
    "blend",
    "carry",
    "carry_steps",
    "conform",
    "dress",
    "dress_steps",
    "map_target",
    "reversed_match",
    "reversed_match_steps",
    "shape_of_source_steps",
    "transfer",
    "transfer_along",
    "transfer_steps",
    "wrap",
    "wrap_steps",
]
