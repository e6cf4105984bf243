# SPDX-License-Identifier: GPL-3.0-or-later
"""Every operator and option links to the guide."""

from pathlib import Path
from urllib.parse import urlparse
from urllib.request import url2pathname

import bpy
import pytest
from drawing import Context, Layout

from blender_addon.properties.match import MatchOptions
from blender_addon.ui import manual, preferences


def looked_up(identifier):
    """The address opened by *Online Manual*."""
    return bpy.types.WM_OT_doc_view_manual._lookup_rna_url(identifier, verbose=False)


@pytest.mark.parametrize("page", [manual.GUIDE, manual.RULES, manual.NEWS])
def test_the_pages_are_there(page):
    assert Path(url2pathname(urlparse(manual.address(page)).path)).read_text(encoding="utf-8").startswith("# ")


def test_operators_and_options_lead_to_their_page():
    for name in dir(bpy.ops.zoomout):
        assert looked_up(f"bpy.ops.zoomout.{name}") in (manual.address(manual.GUIDE), manual.address(manual.RULES))
    for name in MatchOptions.__annotations__:
        assert looked_up(f"bpy.types.ZOOMOUT_PG_settings.{name}") == manual.address(manual.GUIDE)
    assert looked_up("bpy.types.ZOOMOUT_PG_settings.uv_maps") == manual.address(manual.RULES)
    assert looked_up("bpy.types.ZOOMOUT_PG_symmetry.left") == manual.address(manual.GUIDE)
    assert "zoomout" not in looked_up("bpy.ops.mesh.subdivide")


@pytest.mark.parametrize("name", ["match", "transfer", "symmetry"])
def test_panels_have_a_manual_button(name):
    panel = getattr(bpy.types, f"ZOOMOUT_PT_{name}")
    layout = Layout([])
    panel.draw_header_preset(type("Drawn", (), {"layout": layout})(), Context())
    assert layout.operators[0] == "wm.url_open"


def test_preferences_open_the_guide_and_the_release_notes():
    layout = Layout([])
    drawn = {"layout": layout, "bl_rna": preferences.ZOOMOUT_AP_preferences.bl_rna}
    preferences.ZOOMOUT_AP_preferences.draw(type("Drawn", (), drawn)(), Context())
    assert layout.operators == ["wm.url_open", "wm.url_open"]
