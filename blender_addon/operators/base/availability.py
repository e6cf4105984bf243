# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a button can be pressed; a greyed-out one shows why not."""

from __future__ import annotations

from bpy.types import Operator

from ...translations import translated


def is_available(operator: type[Operator], reason: str) -> bool:
    """Whether an operator can run; otherwise its greyed-out button shows the reason, which is given in English."""
    if reason:
        operator.poll_message_set(translated(reason).removesuffix("."))  # Blender adds one
    return not reason
