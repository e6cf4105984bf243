# SPDX-License-Identifier: GPL-3.0-or-later
"""How the options of operators behave."""

# An operator's own options hold for one call only; options that are not set come from the scene.
ONCE = {"SKIP_SAVE"}
