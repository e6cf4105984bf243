# SPDX-License-Identifier: GPL-3.0-or-later
import bpy

settings = bpy.context.scene.zoomout

settings.uv_maps = True
settings.vertex_groups = False
settings.shape_keys = False
settings.color_attributes = True
settings.attributes = True
settings.materials = True
settings.edges = True
settings.custom_normals = True
settings.shape = False
