# SPDX-License-Identifier: GPL-3.0-or-later
"""What each stage and each tuned number of the match is worth."""
