# SPDX-License-Identifier: GPL-3.0-or-later
"""Adapters between Blender's data and the core: a module for each kind, whose `collect` chooses the data of a transfer.

Names are imported on first use.
"""

from typing import TYPE_CHECKING

from zoomout_core.runtime.first_use import names_on_first_use

if TYPE_CHECKING:
    from .adapter import Adapter, Remarks, TransferJob, TransferRequest
    from .collectors import COLLECTORS
    from .kinds import DATA, NOUNS, USUAL_DATA
    from .scheduling import transfer_all
    from .settings import DEFAULT, FILL_BELOW, Binding, Settings, parse_group_names, parse_names
    from .shape_keys import check_takes_keys

__all__ = [
    "COLLECTORS",
    "DATA",
    "DEFAULT",
    "FILL_BELOW",
    "NOUNS",
    "USUAL_DATA",
    "Adapter",
    "Binding",
    "Remarks",
    "Settings",
    "TransferJob",
    "TransferRequest",
    "check_takes_keys",
    "parse_group_names",
    "parse_names",
    "transfer_all",
]

# The module of each name, as in the imports above.
_HOMES = {
    "adapter": (
        "Adapter",
        "Remarks",
        "TransferJob",
        "TransferRequest",
    ),
    "collectors": ("COLLECTORS",),
    "kinds": (
        "DATA",
        "NOUNS",
        "USUAL_DATA",
    ),
    "scheduling": ("transfer_all",),
    "settings": (
        "DEFAULT",
        "FILL_BELOW",
        "Binding",
        "Settings",
        "parse_group_names",
        "parse_names",
    ),
    "shape_keys": ("check_takes_keys",),
}

if not TYPE_CHECKING:  # so that type checkers report unknown names
    __getattr__ = names_on_first_use(__name__, _HOMES)
