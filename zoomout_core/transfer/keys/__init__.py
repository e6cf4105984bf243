# SPDX-License-Identifier: GPL-3.0-or-later
"""Shape keys: their transfer, what faces need beyond other keys, and the names of expressions."""
