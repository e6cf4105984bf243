# SPDX-License-Identifier: GPL-3.0-or-later
"""Make, show and correct the match of two objects."""
