# SPDX-License-Identifier: GPL-3.0-or-later
"""The methods that ZoomOut's paper compares it with, each implemented from its own paper.

A map leads from the target's vertices to the source's, and a functional map has shape (k_target, k_source), as in
`zoomout_core.maps`. Every method starts from a vertex map.
"""
