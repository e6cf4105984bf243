# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators: thin wrappers of functions that scripts can call as well."""

from . import find_source, live_link, symmetry
from .bake_textures import ZOOMOUT_OT_bake_textures
from .bind_to_rig import ZOOMOUT_OT_bind_to_rig
from .check_motion import ZOOMOUT_OT_check_motion
from .choose_data import ZOOMOUT_OT_choose_data
from .clear_data import ZOOMOUT_OT_clear_match_data
from .dress import ZOOMOUT_OT_dress
from .make_lods import ZOOMOUT_OT_make_lods
from .matching import select_faults
from .matching.bend_match import ZOOMOUT_OT_bend_match
from .matching.candidates import ZOOMOUT_OT_swap_match_sides, ZOOMOUT_OT_use_candidate
from .matching.cut_seams import ZOOMOUT_OT_cut_seams
from .matching.landmarks import (
    ZOOMOUT_OT_clear_landmarks,
    ZOOMOUT_OT_confirm_landmarks,
    ZOOMOUT_OT_face_landmarks,
    ZOOMOUT_OT_import_landmarks,
    ZOOMOUT_OT_landmarks_from_selected,
    ZOOMOUT_OT_remove_landmark,
)
from .matching.match import ZOOMOUT_OT_match
from .matching.match_collections import ZOOMOUT_OT_match_collections
from .matching.place_landmarks import ZOOMOUT_OT_place_landmarks
from .move_rig import ZOOMOUT_OT_move_rig
from .play_expressions import ZOOMOUT_OT_play_expressions
from .play_test_poses import ZOOMOUT_OT_test_poses
from .preview import ZOOMOUT_OT_clear_preview, ZOOMOUT_OT_preview
from .rename_shape_keys import ZOOMOUT_OT_rename_shape_keys
from .transfer import ZOOMOUT_OT_transfer
from .wrap import ZOOMOUT_OT_wrap

# In the order of registration.
CLASSES = (
    ZOOMOUT_OT_match,
    ZOOMOUT_OT_use_candidate,
    ZOOMOUT_OT_swap_match_sides,
    *select_faults.CLASSES,
    ZOOMOUT_OT_preview,
    ZOOMOUT_OT_clear_preview,
    ZOOMOUT_OT_clear_match_data,
    ZOOMOUT_OT_choose_data,
    ZOOMOUT_OT_transfer,
    *live_link.CLASSES,
    ZOOMOUT_OT_bake_textures,
    ZOOMOUT_OT_rename_shape_keys,
    ZOOMOUT_OT_play_expressions,
    ZOOMOUT_OT_bind_to_rig,
    ZOOMOUT_OT_move_rig,
    ZOOMOUT_OT_test_poses,
    ZOOMOUT_OT_check_motion,
    ZOOMOUT_OT_wrap,
    ZOOMOUT_OT_dress,
    ZOOMOUT_OT_cut_seams,
    ZOOMOUT_OT_make_lods,
    ZOOMOUT_OT_place_landmarks,
    ZOOMOUT_OT_landmarks_from_selected,
    ZOOMOUT_OT_face_landmarks,
    ZOOMOUT_OT_import_landmarks,
    ZOOMOUT_OT_bend_match,
    ZOOMOUT_OT_confirm_landmarks,
    ZOOMOUT_OT_remove_landmark,
    ZOOMOUT_OT_clear_landmarks,
    ZOOMOUT_OT_match_collections,
    *find_source.CLASSES,
    *symmetry.CLASSES,
)
