# SPDX-License-Identifier: GPL-3.0-or-later
"""Drawing in the 3D views: colours over objects, numbered landmarks."""
