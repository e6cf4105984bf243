# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole test lists of public sets: errors by the published protocol, beside published figures."""
