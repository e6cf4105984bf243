# SPDX-License-Identifier: GPL-3.0-or-later
"""The interface: panels of the sidebar, menus, thumbnails, the pages of the manual."""
