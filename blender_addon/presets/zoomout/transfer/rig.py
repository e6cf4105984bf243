# SPDX-License-Identifier: GPL-3.0-or-later
import bpy

settings = bpy.context.scene.zoomout

settings.uv_maps = False
settings.vertex_groups = True
settings.shape_keys = True
settings.color_attributes = False
settings.attributes = False
settings.materials = False
settings.edges = False
settings.custom_normals = False
settings.shape = False
