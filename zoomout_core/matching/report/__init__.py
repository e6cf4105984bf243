# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of a match: verdict, parts of the source, and notes."""
