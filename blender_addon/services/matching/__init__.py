# SPDX-License-Identifier: GPL-3.0-or-later
"""Make, show and correct the match of two objects."""

from typing import TYPE_CHECKING

from zoomout_core.runtime.first_use import modules_on_first_use

if TYPE_CHECKING:
    from . import bend_match as bend_match
    from . import cached_results as cached_results
    from . import candidates as candidates
    from . import collection_match as collection_match
    from . import half_match as half_match
    from . import hints as hints
    from . import initial_maps as initial_maps
    from . import joined_match as joined_match
    from . import landmark_import as landmark_import
    from . import made_match as made_match
    from . import match as match
    from . import name_matching as name_matching
    from . import pair_match as pair_match
    from . import parts as parts
    from . import prepare_ahead as prepare_ahead
    from . import previews as previews
    from . import propose_partners as propose_partners
    from . import redo_match as redo_match
    from . import seam_cut as seam_cut
    from . import select_faults as select_faults
    from . import use_candidate as use_candidate
else:
    __getattr__ = modules_on_first_use(__name__)
