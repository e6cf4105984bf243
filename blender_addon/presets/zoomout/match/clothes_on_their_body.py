# SPDX-License-Identifier: GPL-3.0-or-later
import bpy

settings = bpy.context.scene.zoomout

settings.initial = "NEAREST"
for name in ("max_distance", "max_angle", "either_side"):
    settings.property_unset(name)
