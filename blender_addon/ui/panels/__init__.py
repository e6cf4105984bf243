# SPDX-License-Identifier: GPL-3.0-or-later
"""The sidebar of the 3D view."""

from . import symmetry
from .bake import ZOOMOUT_PT_bake
from .binding import ZOOMOUT_PT_binding, ZOOMOUT_PT_binding_check
from .collections import ZOOMOUT_PT_collections
from .dress import ZOOMOUT_PT_dress
from .expressions import ZOOMOUT_PT_expressions
from .landmarks import ZOOMOUT_PT_landmarks, ZOOMOUT_UL_landmarks
from .library import ZOOMOUT_PT_library
from .live_link import ZOOMOUT_PT_live_link
from .lods import ZOOMOUT_PT_lods
from .match import ZOOMOUT_PT_match
from .match_options import ZOOMOUT_PT_hints, ZOOMOUT_PT_match_advanced
from .result import ZOOMOUT_PT_result
from .transfer import ZOOMOUT_PT_report, ZOOMOUT_PT_transfer
from .transfer_options import ZOOMOUT_PT_blending, ZOOMOUT_PT_naming, ZOOMOUT_PT_topology
from .wrap import ZOOMOUT_PT_wrap

# In the order of registration: a panel before its subpanels, whose order is in `bl_order`.
CLASSES = (
    ZOOMOUT_UL_landmarks,
    ZOOMOUT_PT_match,
    ZOOMOUT_PT_result,
    ZOOMOUT_PT_landmarks,
    ZOOMOUT_PT_hints,
    ZOOMOUT_PT_match_advanced,
    ZOOMOUT_PT_transfer,
    ZOOMOUT_PT_report,
    ZOOMOUT_PT_live_link,
    ZOOMOUT_PT_bake,
    ZOOMOUT_PT_lods,
    ZOOMOUT_PT_blending,
    ZOOMOUT_PT_naming,
    ZOOMOUT_PT_topology,
    ZOOMOUT_PT_expressions,
    ZOOMOUT_PT_binding,
    ZOOMOUT_PT_binding_check,
    ZOOMOUT_PT_wrap,
    ZOOMOUT_PT_dress,
    ZOOMOUT_PT_collections,
    ZOOMOUT_PT_library,
    *symmetry.CLASSES,
)
