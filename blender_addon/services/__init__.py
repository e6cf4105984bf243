# SPDX-License-Identifier: GPL-3.0-or-later
"""What operators, panels, the command line and `api` share: the work on objects of a scene, without any interface."""
