# SPDX-License-Identifier: GPL-3.0-or-later
"""Named sets of options, stored as Blender's presets in the user's folder, for all files.

Shipped presets are in the folder `zoomout`, and are named by their files.
"""

from __future__ import annotations

from pathlib import Path

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel
from bpy.types import Operator, Panel

from ..properties.match import MatchOptions
from ..properties.transfer import BindChoice, BindOptions, BindView, BlendOptions, TransferOptions

# Where Blender looks for a folder `presets`.
HOME = str(Path(__file__).parent.parent)


class ZOOMOUT_PT_match_presets(PresetPanel, Panel):
    bl_label = "Match Presets"
    preset_subdir = "zoomout/match"
    preset_operator = "script.execute_preset"
    preset_add_operator = "zoomout.add_match_preset"


class ZOOMOUT_PT_transfer_presets(PresetPanel, Panel):
    bl_label = "Transfer Presets"
    preset_subdir = "zoomout/transfer"
    preset_operator = "script.execute_preset"
    preset_add_operator = "zoomout.add_transfer_preset"


class SettingsPreset(AddPresetBase):
    """The base of operators that add or remove a preset of some options of the scene's settings."""

    preset_defines = ("settings = bpy.context.scene.zoomout",)


class ZOOMOUT_OT_add_match_preset(SettingsPreset, Operator):
    bl_idname = "zoomout.add_match_preset"
    bl_label = "Add Match Preset"
    bl_description = "Save the match options as a preset, or remove a preset"
    preset_menu = ZOOMOUT_PT_match_presets.__name__
    preset_subdir = ZOOMOUT_PT_match_presets.preset_subdir
    preset_values = tuple(f"settings.{name}" for name in MatchOptions.__annotations__)


class ZOOMOUT_OT_add_transfer_preset(SettingsPreset, Operator):
    bl_idname = "zoomout.add_transfer_preset"
    bl_label = "Add Transfer Preset"
    bl_description = "Save the transfer options as a preset, or remove a preset"
    preset_menu = ZOOMOUT_PT_transfer_presets.__name__
    preset_subdir = ZOOMOUT_PT_transfer_presets.preset_subdir
    preset_values = tuple(
        f"settings.{name}"
        for group in (TransferOptions, BlendOptions, BindChoice, BindOptions, BindView)
        for name in group.__annotations__
    )


# In the order of registration.
CLASSES = (
    ZOOMOUT_PT_match_presets,
    ZOOMOUT_PT_transfer_presets,
    ZOOMOUT_OT_add_match_preset,
    ZOOMOUT_OT_add_transfer_preset,
)


def register() -> None:
    """Register the shipped presets with Blender."""
    bpy.utils.register_preset_path(HOME)


def unregister() -> None:
    """Unregister the shipped presets."""
    bpy.utils.unregister_preset_path(HOME)
