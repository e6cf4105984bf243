# SPDX-License-Identifier: GPL-3.0-or-later
"""The order of candidates, and the certainty of each."""
