# SPDX-License-Identifier: GPL-3.0-or-later
"""Adapters between Blender's data and the core: a module for each kind, whose `collect` chooses the data of a transfer.

Names are imported on first use.
"""

from typing import TYPE_CHECKING

from zoomout_core.runtime.first_use import imports_on_first_use

if TYPE_CHECKING:
    from .adapter import Adapter, Remarks, TransferJob, TransferRequest
    from .collectors import COLLECTORS
    from .kinds import DATA, NOUNS, USUAL_DATA
    from .scheduling import transfer_all
    from .settings import DEFAULT, FILL_BELOW, Binding, Settings, parse_group_names, parse_names
    from .shape_keys import check_takes_keys

if not TYPE_CHECKING:  # so that type checkers report unknown names
    __getattr__ = imports_on_first_use(__name__, __file__)
