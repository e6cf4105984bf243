# SPDX-License-Identifier: GPL-3.0-or-later
"""Base classes of operators, and modules they share: modal work, modes, preparation while Blender is idle."""
