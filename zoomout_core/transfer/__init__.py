# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfer of attributes from a source surface to a target, along a map between them.

Names are imported on first use.
"""

from typing import TYPE_CHECKING

from zoomout_core.runtime.first_use import names_on_first_use

if TYPE_CHECKING:
    from zoomout_core.transfer.attribute import Attribute, Domain, Kind
    from zoomout_core.transfer.blend_settings import MODES, Blend, Mode
    from zoomout_core.transfer.dressing.body_keys import follow_keys
    from zoomout_core.transfer.dressing.body_weights import WeightedBody, follow_weights, moving_with_skin
    from zoomout_core.transfer.dressing.dress import clear_in_poses, dress, fit_to_shape, shape_of_source
    from zoomout_core.transfer.dressing.fitted_object import Manner
    from zoomout_core.transfer.dressing.form import Lines
    from zoomout_core.transfer.dressing.joint_alignment import JointPairs, align_joints
    from zoomout_core.transfer.dressing.layers import Dressed
    from zoomout_core.transfer.dressing.posed_contact import PosedBody
    from zoomout_core.transfer.rigging.bone_pairs import Skeleton, pair_bones
    from zoomout_core.transfer.rigging.joints import MovedJoints, move_joints
    from zoomout_core.transfer.rigging.rig import move_rig
    from zoomout_core.transfer.rules import RULES, Rule, conform, map_target, transfer, transfer_along
    from zoomout_core.transfer.wrapping.wrap import Wrapped, reverse_match, wrap

__all__ = [
    "MODES",
    "RULES",
    "Attribute",
    "Blend",
    "Domain",
    "Dressed",
    "JointPairs",
    "Kind",
    "Lines",
    "Manner",
    "Mode",
    "MovedJoints",
    "PosedBody",
    "Rule",
    "Skeleton",
    "WeightedBody",
    "Wrapped",
    "align_joints",
    "clear_in_poses",
    "conform",
    "dress",
    "fit_to_shape",
    "follow_keys",
    "follow_weights",
    "map_target",
    "move_joints",
    "move_rig",
    "moving_with_skin",
    "pair_bones",
    "reverse_match",
    "shape_of_source",
    "transfer",
    "transfer_along",
    "wrap",
]

# The module of each name, as in the imports above.
_HOMES = {
    "attribute": (
        "Attribute",
        "Domain",
        "Kind",
    ),
    "blend_settings": (
        "MODES",
        "Blend",
        "Mode",
    ),
    "dressing.body_keys": ("follow_keys",),
    "dressing.body_weights": (
        "WeightedBody",
        "follow_weights",
        "moving_with_skin",
    ),
    "dressing.dress": (
        "fit_to_shape",
        "clear_in_poses",
        "dress",
        "shape_of_source",
    ),
    "dressing.fitted_object": ("Manner",),
    "dressing.form": ("Lines",),
    "dressing.joint_alignment": (
        "JointPairs",
        "align_joints",
    ),
    "dressing.layers": ("Dressed",),
    "dressing.posed_contact": ("PosedBody",),
    "rigging.bone_pairs": (
        "Skeleton",
        "pair_bones",
    ),
    "rigging.joints": (
        "MovedJoints",
        "move_joints",
    ),
    "rigging.rig": ("move_rig",),
    "rules": (
        "RULES",
        "Rule",
        "conform",
        "map_target",
        "transfer",
        "transfer_along",
    ),
    "wrapping.wrap": (
        "Wrapped",
        "reverse_match",
        "wrap",
    ),
}

if not TYPE_CHECKING:  # so that type checkers report unknown names
    __getattr__ = names_on_first_use(__name__, _HOMES)
