# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfer of attributes from a source surface to a target, along a map between them."""

from zoomout_core.transfer.attribute import Attribute, Domain, Kind
from zoomout_core.transfer.blend import MODES, Blend, Mode, blend
from zoomout_core.transfer.dressing.body_keys import follow_keys
from zoomout_core.transfer.dressing.body_weights import WeightedBody, follow_weights, moving_with_skin
from zoomout_core.transfer.dressing.dress import Dressed, Manner, carry, clear_in_poses, dress, shape_of_source
from zoomout_core.transfer.dressing.form import Lines
from zoomout_core.transfer.dressing.joint_alignment import JointPairs, align_joints
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
    "blend",
    "carry",
    "clear_in_poses",
    "conform",
    "dress",
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
