# SPDX-License-Identifier: GPL-3.0-or-later
"""Functions on objects of a scene, without an interface: operators, panels, the command line and `api` share them.

Modules are imported on first use, as `services.wrap.prepare_wrap`.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from zoomout_core.runtime.first_use import modules_on_first_use

from ..jobs import compute

if TYPE_CHECKING:
    from . import bake as bake
    from . import binding as binding
    from . import check_motion as check_motion
    from . import clear_data as clear_data
    from . import dressing as dressing
    from . import expressions as expressions
    from . import face_landmarks as face_landmarks
    from . import found_pictures as found_pictures
    from . import inventory as inventory
    from . import key_names as key_names
    from . import library as library
    from . import live_link as live_link
    from . import lods as lods
    from . import matching as matching
    from . import outfits as outfits
    from . import preflight as preflight
    from . import symmetry as symmetry
    from . import targets as targets
    from . import transfer as transfer
    from . import transfer_files as transfer_files
    from . import transfer_report as transfer_report
    from . import wrap as wrap
else:
    __getattr__ = modules_on_first_use(__name__)


async def load() -> None:
    """Import what nearly all work needs, without keeping the window waiting."""
    if "transfer" not in globals():
        await compute(_import_modules)


def _import_modules() -> None:
    for module in (".matching.match", ".transfer"):
        import_module(module, __name__)
