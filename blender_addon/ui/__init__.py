"""The interface: panels of the sidebar, menus, thumbnails, the pages of the manual."""
