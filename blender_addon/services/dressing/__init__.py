# SPDX-License-Identifier: GPL-3.0-or-later
"""Dress a target in copies of the objects that its source wears: read, fit, write."""

from typing import TYPE_CHECKING

from zoomout_core.runtime.first_use import modules_on_first_use

if TYPE_CHECKING:
    from . import dress as dress
    from . import fit as fit
    from . import read as read
    from . import worn_weights as worn_weights
    from . import write as write
else:
    __getattr__ = modules_on_first_use(__name__)
