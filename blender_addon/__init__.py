"""Attribute transfer between meshes of different poses and topologies, as an extension."""

import bpy

import zoomout_core as zo

from .operators.cut_seams import ZOOMOUT_OT_cut_seams
from .operators.match import ZOOMOUT_OT_match
from .operators.transfer import ZOOMOUT_OT_transfer
from .panels import ZOOMOUT_PT_match, ZOOMOUT_PT_transfer
from .properties import ZOOMOUT_PG_settings

_register_classes, _unregister_classes = bpy.utils.register_classes_factory(
    (
        ZOOMOUT_PG_settings,
        ZOOMOUT_OT_match,
        ZOOMOUT_OT_transfer,
        ZOOMOUT_OT_cut_seams,
        ZOOMOUT_PT_match,
        ZOOMOUT_PT_transfer,
    )
)


def register() -> None:
    """Make the operators, the panels and the scene's settings known to Blender."""
    _register_classes()
    bpy.types.Scene.zoomout = bpy.props.PointerProperty(type=ZOOMOUT_PG_settings)
    if __package__.startswith("bl_ext."):  # installed, so that Blender has a folder for it
        zo.store_shapes(bpy.utils.extension_path_user(__package__, path="shapes", create=True))


def unregister() -> None:
    """Take them away again."""
    del bpy.types.Scene.zoomout
    _unregister_classes()
    zo.forget_shapes()
    zo.store_shapes(None)
