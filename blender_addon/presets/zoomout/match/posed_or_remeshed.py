# SPDX-License-Identifier: GPL-3.0-or-later
import bpy

settings = bpy.context.scene.zoomout

for name in ("initial", "detail", "k_final", "names", "same_up", "upright", "from_last"):
    settings.property_unset(name)
