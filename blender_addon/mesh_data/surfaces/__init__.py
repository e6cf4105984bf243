# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects as surfaces of the core, points on them, and facts about them."""
