# SPDX-License-Identifier: GPL-3.0-or-later
"""What is done along the symmetry that is stored on a mesh."""
