# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects as surfaces of the core, with points on them and properties of them."""
