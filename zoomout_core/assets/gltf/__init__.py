# SPDX-License-Identifier: GPL-3.0-or-later
"""glTF and VRM files as assets."""
