# SPDX-License-Identifier: GPL-3.0-or-later
"""Libraries of finished characters, and the search for the one that fits a new body."""
