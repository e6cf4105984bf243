# SPDX-License-Identifier: GPL-3.0-or-later
"""Bind a target to the armature of its source: check, read, bind, write."""

from typing import TYPE_CHECKING

from zoomout_core.runtime.first_use import modules_on_first_use

if TYPE_CHECKING:
    from . import bind as bind
    from . import check as check
    from . import loose_armature as loose_armature
    from . import part as part
    from . import read as read
    from . import write as write
else:
    __getattr__ = modules_on_first_use(__name__)
