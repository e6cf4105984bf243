# SPDX-License-Identifier: GPL-3.0-or-later
"""Images as arrays, and the nodes of materials that use them."""
