# SPDX-License-Identifier: GPL-3.0-or-later
"""The work on objects of a scene, without interface: shared by operators, panels, the command line and `api`."""
