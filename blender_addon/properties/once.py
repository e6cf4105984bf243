# SPDX-License-Identifier: GPL-3.0-or-later
"""Flags of operators' options."""

# An operator's options apply to one call; unset options come from the scene.
ONCE = {"SKIP_SAVE"}
