# SPDX-License-Identifier: GPL-3.0-or-later
"""Bones: weights, poses and their inverses, and rigs that move into other bodies."""

from typing import TYPE_CHECKING

from zoomout_core.runtime.first_use import modules_on_first_use

if TYPE_CHECKING:
    from zoomout_core.transfer.rigging import motion as motion
    from zoomout_core.transfer.rigging import poses as poses
else:
    __getattr__ = modules_on_first_use(__name__)
