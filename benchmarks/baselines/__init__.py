# SPDX-License-Identifier: GPL-3.0-or-later
"""Methods that the ZoomOut paper compares with, each implemented from its own paper.

A map leads from the target's vertices to the source's, and a functional map has shape (k_target, k_source), as in
`zoomout_core.maps`. Every method starts from a vertex map.
"""
