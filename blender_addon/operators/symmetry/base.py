# SPDX-License-Identifier: GPL-3.0-or-later
"""The base of operators that work along a symmetry stored on the active mesh."""

from __future__ import annotations

from bpy.types import Context

from ...storage import stored_symmetry
from ..base.availability import is_available
from ..base.modal_operator import ModalOperator


class SymmetryOperator(ModalOperator):
    """The base of operators that need the symmetry of the active mesh."""

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether the active object is a mesh whose symmetry is known."""
        if not super().poll(context):
            return False
        is_known = stored_symmetry.PROPERTY in context.active_object.data
        return is_available(cls, "" if is_known else "Detect the symmetry of this mesh first")
