"""Colours that show a match: how far to trust it, and where on the source each vertex belongs."""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Floats

# From no confidence to full: apart for the colour-blind, and not taken for weights, which Blender shows blue to red.
CONFIDENCE_COLORS = np.array([[0.75, 0.12, 0.08], [0.96, 0.55, 0.25], [0.95, 0.92, 0.70], [0.30, 0.62, 0.80]])
# Darkest and lightest value of each channel of the colours of places, so that both stand out from either theme.
DARK, LIGHT = 0.08, 0.98


def confidence_colors(confidence: Floats) -> Floats:
    """(n, 3) colours of confidences (n,)."""
    steps = np.linspace(0, 1, len(CONFIDENCE_COLORS))
    return np.column_stack([np.interp(confidence, steps, channel) for channel in CONFIDENCE_COLORS.T])


def place_colors(points: Floats, around: Floats) -> Floats:
    """(m, 3) colours of points (m, 3): red across, green along and blue up the box around all points (n, 3)."""
    low, high = np.nanmin(around, axis=0), np.nanmax(around, axis=0)
    share = (points - low) / np.where(high > low, high - low, 1)
    return DARK + (LIGHT - DARK) * np.nan_to_num(share).clip(0, 1)
