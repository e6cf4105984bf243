# SPDX-License-Identifier: GPL-3.0-or-later
"""Shape keys, and the drivers that play them."""
