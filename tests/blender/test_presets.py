# SPDX-License-Identifier: GPL-3.0-or-later
"""Named presets of options, stored like Blender's."""

from pathlib import Path

import bpy
import pytest

from blender_addon import presets
from blender_addon.properties.match import MatchOptions
from blender_addon.properties.transfer import BindChoice, BindOptions, BindView, BlendOptions, TransferOptions


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A folder for presets in place of the user's own."""
    monkeypatch.setenv("BLENDER_USER_SCRIPTS", str(tmp_path))
    for panel in (presets.ZOOMOUT_PT_match_presets, presets.ZOOMOUT_PT_transfer_presets):
        monkeypatch.setattr(panel, "bl_label", panel.bl_label)  # Blender writes the last preset's name there
    assert bpy.utils.user_resource("SCRIPTS") == str(tmp_path)
    return tmp_path / "presets" / "zoomout"


def changed(group):
    """A non-default value for each option of a group."""
    found = {}
    for name, option in group.__annotations__.items():
        default = option.keywords.get("default", "")
        if isinstance(default, bool):
            found[name] = not default
        elif option.function.__name__ == "EnumProperty":
            found[name] = next(identifier for identifier, *_ in option.keywords["items"] if identifier != default)
        else:
            found[name] = "Name" if isinstance(default, str) else default / 2 if default else 1
    return found


@pytest.mark.parametrize(
    ("what", "groups"),
    [("match", [MatchOptions]), ("transfer", [TransferOptions, BlendOptions, BindChoice, BindOptions, BindView])],
)
def test_options_are_saved_and_restored_by_preset(folder, what, groups):
    settings = bpy.context.scene.zoomout
    wanted = {name: value for group in groups for name, value in changed(group).items()}
    for name, value in wanted.items():
        setattr(settings, name, value)
    add = getattr(bpy.ops.zoomout, f"add_{what}_preset")
    assert add(name="Scans of heads") == {"FINISHED"}
    (kept,) = (folder / what).iterdir()
    for name in wanted:
        settings.property_unset(name)
    menu = f"ZOOMOUT_PT_{what}_presets"
    assert bpy.ops.script.execute_preset(filepath=str(kept), menu_idname=menu) == {"FINISHED"}
    assert {name: getattr(settings, name) for name in wanted} == pytest.approx(wanted)
    assert add(name="Scans of heads", remove_name=True) == {"FINISHED"}
    assert not kept.exists()


def test_bundled_presets_set_their_options():
    settings = bpy.context.scene.zoomout
    settings.detail = "FINE"
    for what, name, wanted in (
        ("match", "clothes_on_their_body", {"initial": "NEAREST"}),
        ("match", "posed_or_remeshed", {"initial": "AUTO", "detail": "BALANCED"}),
        ("transfer", "rig", {"vertex_groups": True, "shape_keys": True, "uv_maps": False, "materials": False}),
        ("transfer", "surface", {"vertex_groups": False, "shape_keys": False, "uv_maps": True, "materials": True}),
    ):
        path, menu = bpy.utils.preset_find(name, f"zoomout/{what}"), f"ZOOMOUT_PT_{what}_presets"
        assert bpy.ops.script.execute_preset(filepath=path, menu_idname=menu) == {"FINISHED"}
        assert {option: getattr(settings, option) for option in wanted} == wanted
        if what == "transfer":
            written = Path(path).read_text(encoding="utf-8")
            assert all(f"settings.{option} = " in written for option in TransferOptions.__annotations__)


def test_a_preset_leaves_other_settings_alone(folder):
    presets_of = {cls.preset_menu: cls.preset_values for cls in presets.CLASSES if hasattr(cls, "preset_values")}
    match, transfer = (set(values) for values in presets_of.values())
    assert not match & transfer
    assert not {"settings.source", "settings.landmarks", "settings.symmetry"} & (match | transfer)
