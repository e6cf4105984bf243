# SPDX-License-Identifier: GPL-3.0-or-later
"""Work along the symmetry stored on a mesh."""
