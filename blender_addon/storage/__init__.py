# SPDX-License-Identifier: GPL-3.0-or-later
"""Results stored on meshes: a match, its candidates, the report of a transfer, symmetries."""
