# SPDX-License-Identifier: GPL-3.0-or-later
"""Options: each is defined once, and is a setting of the scene as well as a property of the operators."""
