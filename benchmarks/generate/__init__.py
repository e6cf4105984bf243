# SPDX-License-Identifier: GPL-3.0-or-later
"""Generate sets of meshes with known correspondences: `python -m benchmarks.generate NAME`."""
