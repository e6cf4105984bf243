# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a button can be pressed; a greyed-out one shows why not."""

from __future__ import annotations

from bpy.types import Operator

from ...translations import translated


def is_available(operator: type[Operator], reason: str) -> bool:
    """Whether there is no reason against an operator, in English; its greyed-out button shows the reason."""
    if reason:
        operator.poll_message_set(translated(reason).removesuffix("."))  # Blender adds one
    return not reason
