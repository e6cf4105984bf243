# SPDX-License-Identifier: GPL-3.0-or-later
"""The target bent onto the source, limb by limb."""
