# SPDX-License-Identifier: GPL-3.0-or-later
"""Work along the symmetry stored on a mesh."""

from typing import TYPE_CHECKING

from zoomout_core.runtime.first_use import modules_on_first_use

if TYPE_CHECKING:
    from . import check as check
    from . import detect as detect
    from . import layers as layers
    from . import mesh_access as mesh_access
    from . import sculpt as sculpt
    from . import shape_keys as shape_keys
    from . import sides as sides
    from . import weights as weights
else:
    __getattr__ = modules_on_first_use(__name__)
