# SPDX-License-Identifier: GPL-3.0-or-later
"""Attribute transfer between meshes of different poses and topologies, as an extension."""

from collections.abc import Iterator
from contextlib import contextmanager

import bpy

import zoomout_core as zo

from . import cli, operators, presets, translations, watch
from .operators.base import running_operators
from .properties.landmarks import CLASSES as LANDMARK_CLASSES
from .properties.library import CLASSES as LIBRARY_CLASSES
from .properties.settings import ZOOMOUT_PG_settings
from .properties.symmetry import ZOOMOUT_PG_symmetry
from .ui import manual, menus, panels, preferences, thumbnails
from .viewport import landmark_dots

_register_classes, _unregister_classes = bpy.utils.register_classes_factory(
    (
        ZOOMOUT_PG_symmetry,
        *LANDMARK_CLASSES,
        *LIBRARY_CLASSES,
        ZOOMOUT_PG_settings,
        *operators.CLASSES,
        *presets.CLASSES,
        *panels.CLASSES,
        *menus.CLASSES,
        *preferences.CLASSES,
    )
)


def register() -> None:
    """Register the operators, the panels and the scene's settings with Blender."""
    _register_classes()
    watch.register()
    landmark_dots.register()
    menus.register()
    manual.register()
    presets.register()
    translations.register()
    cli.register()
    bpy.types.Scene.zoomout = bpy.props.PointerProperty(type=ZOOMOUT_PG_settings)
    if __package__.startswith("bl_ext."):  # installed, so that Blender has a folder for it
        zo.store_shapes(bpy.utils.extension_path_user(__package__, path="shapes", create=True))


def unregister() -> None:
    """Undo `register`."""
    running_operators.cancel_all()
    watch.unregister()
    thumbnails.unregister()
    cli.unregister()
    translations.unregister()
    presets.unregister()
    manual.unregister()
    menus.unregister()
    landmark_dots.unregister()
    del bpy.types.Scene.zoomout
    _unregister_classes()
    zo.forget_shapes()
    zo.store_shapes(None)


@contextmanager
def registered() -> Iterator[None]:
    """Register the add-on for a block, unless it is registered already, so that it runs without being installed."""
    if hasattr(bpy.types.Scene, "zoomout"):
        yield
        return
    register()
    try:
        yield
    finally:
        unregister()
