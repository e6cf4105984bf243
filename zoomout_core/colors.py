# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours for displaying maps: places, confidence, and areas without a partner."""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Booleans, Floats

# From bad to good: distinct for colour-blind users, and unlike Blender's weight colours from blue to red.
BAD_TO_GOOD = np.array([[0.75, 0.12, 0.08], [0.96, 0.55, 0.25], [0.95, 0.92, 0.70], [0.30, 0.62, 0.80]])
# Colours of areas without a partner, and, on the source, of areas with one.
LONELY, MET = np.array([0.34, 0.13, 0.50]), np.array([0.80, 0.80, 0.78])
# Minimum and maximum of each channel of position colours, so that they differ from light and dark themes.
DARK, LIGHT = 0.08, 0.98


def confidence_colors(confidence: Floats, has_partner: Booleans | None = None) -> Floats:
    """(n, 3) colours of confidences (n,), with a separate colour for vertices without a partner (n,), if known."""
    steps = np.linspace(0, 1, len(BAD_TO_GOOD))
    colors = np.column_stack([np.interp(confidence, steps, channel) for channel in BAD_TO_GOOD.T])
    return colors if has_partner is None else np.where(has_partner[:, None], colors, LONELY)


def partner_colors(has_partner: Booleans) -> Floats:
    """(n, 3) colours of a source's vertices with and without partners (n,)."""
    return np.where(has_partner[:, None], MET, LONELY)


def place_colors(points: Floats, around: Floats) -> Floats:
    """(m, 3) colours of points (m, 3): red, green and blue along the axes of the box around all points (n, 3)."""
    low, high = np.nanmin(around, axis=0), np.nanmax(around, axis=0)
    share = (points - low) / np.where(high > low, high - low, 1)
    return DARK + (LIGHT - DARK) * np.nan_to_num(share).clip(0, 1)
