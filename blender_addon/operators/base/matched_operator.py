# SPDX-License-Identifier: GPL-3.0-or-later
"""The base of operators on the match of the active mesh."""

from __future__ import annotations

from bpy.types import Context

from ...storage import stored_match
from .availability import is_available
from .modal_operator import ModalOperator


class MatchedOperator(ModalOperator):
    """The base of operators that need the match of the active mesh."""

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether the active object was matched."""
        if not super().poll(context):
            return False
        is_matched = stored_match.PROPERTY in context.active_object.data
        return is_available(cls, "" if is_matched else "Match this mesh first")
