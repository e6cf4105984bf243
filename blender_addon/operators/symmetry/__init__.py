# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that find a mesh's own symmetry, and work along it."""

from .check import ZOOMOUT_OT_check_symmetry
from .detect import ZOOMOUT_OT_choose_symmetry, ZOOMOUT_OT_detect_symmetry, ZOOMOUT_OT_swap_sides
from .layers import ZOOMOUT_OT_mirror_attributes
from .sculpt import ZOOMOUT_OT_mirror_sculpt
from .shape_keys import ZOOMOUT_OT_mirror_shape_key
from .sides import ZOOMOUT_OT_name_sides, ZOOMOUT_OT_select_symmetry_line
from .weights import ZOOMOUT_OT_symmetrise_weights

# In the order of registration.
CLASSES = (
    ZOOMOUT_OT_detect_symmetry,
    ZOOMOUT_OT_choose_symmetry,
    ZOOMOUT_OT_swap_sides,
    ZOOMOUT_OT_symmetrise_weights,
    ZOOMOUT_OT_mirror_shape_key,
    ZOOMOUT_OT_mirror_attributes,
    ZOOMOUT_OT_mirror_sculpt,
    ZOOMOUT_OT_check_symmetry,
    ZOOMOUT_OT_select_symmetry_line,
    ZOOMOUT_OT_name_sides,
)
