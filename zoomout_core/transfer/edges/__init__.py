# SPDX-License-Identifier: GPL-3.0-or-later
"""Data on edges, which is transferred as lines or as a field."""
