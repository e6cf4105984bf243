"""The interface: panels of the sidebar, menus, small pictures in lists, the pages of the manual."""
