# SPDX-License-Identifier: GPL-3.0-or-later
import bpy

settings = bpy.context.scene.zoomout

settings.initial = "NEAREST"
for name in ("most_distance", "most_angle", "either_side"):
    settings.property_unset(name)
