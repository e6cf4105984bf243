# SPDX-License-Identifier: GPL-3.0-or-later
"""Sets of meshes with known correspondences, made rather than collected: `python -m benchmarks.generate NAME`."""
