# SPDX-License-Identifier: GPL-3.0-or-later
"""Options, each defined once, both for the scene's settings and for the operators' properties."""
