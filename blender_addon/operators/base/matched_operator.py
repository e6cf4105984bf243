# SPDX-License-Identifier: GPL-3.0-or-later
"""The base of operators on the match of the active mesh."""

from __future__ import annotations

from bpy.types import Context

from ...storage import stored_match
from ...translations import translated
from .modal_operator import ModalOperator


class MatchedOperator(ModalOperator):
    """The base of operators that need the match of the active mesh."""

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether the active object was matched."""
        if not super().poll(context):
            return False
        if stored_match.PROPERTY not in context.active_object.data:
            cls.poll_message_set(translated("Match this mesh first"))
            return False
        return True
