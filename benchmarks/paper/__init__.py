# SPDX-License-Identifier: GPL-3.0-or-later
"""The tables and figures of ZoomOut's paper, beside the published ones."""
