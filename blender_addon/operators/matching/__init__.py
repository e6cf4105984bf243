# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators of the match, its landmarks, candidates and faults."""
