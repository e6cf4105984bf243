# SPDX-License-Identifier: GPL-3.0-or-later
"""A surface matched to itself."""

from typing import TYPE_CHECKING

from zoomout_core.runtime.first_use import modules_on_first_use

if TYPE_CHECKING:
    from zoomout_core.symmetry import self_map as self_map
else:
    __getattr__ = modules_on_first_use(__name__)
