# SPDX-License-Identifier: GPL-3.0-or-later
"""From a candidate on samples to a dense map: refinement, repair and confidence."""
