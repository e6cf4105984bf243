# SPDX-License-Identifier: GPL-3.0-or-later
"""Outfits of avatar files, fitted to other avatars."""

from typing import TYPE_CHECKING

from zoomout_core.runtime.first_use import modules_on_first_use

if TYPE_CHECKING:
    from zoomout_core.outfits import parts as parts
else:
    __getattr__ = modules_on_first_use(__name__)
