# SPDX-License-Identifier: GPL-3.0-or-later
"""Shape keys: their transfer, additional rules for faces, and the names of expressions."""
