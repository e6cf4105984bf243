# SPDX-License-Identifier: GPL-3.0-or-later
"""The effect of each stage and of each tuned number on the match."""
