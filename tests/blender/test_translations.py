# SPDX-License-Identifier: GPL-3.0-or-later
"""Nearly every text of the interface has its translation, and no translation outlives its text."""

import ast
from pathlib import Path

import bpy
import pytest

from blender_addon import operators, presets, translations
from blender_addon.ui import menus, panels, preferences
from blender_addon.viewport import preview

# The same in every language.
NAMES = {"ZoomOut", menus.EXTENSION, "ESC", "X", "-X", "Y", "-Y", "Z", "-Z"}
# A language that lacks more is no help: whoever adds texts may leave a few to those who know it.
MOST_MISSING = 0.1


def of_properties(owner):
    """Names and tooltips of what an operator or a group of settings has."""
    found = set()
    for option in owner.properties:
        if option.identifier in ("rna_type", "name") or option.is_hidden:
            continue
        found |= {option.name, option.description}
        for choice in option.enum_items if option.type == "ENUM" else ():
            found |= {choice.name, choice.description}
        if option.type in ("POINTER", "COLLECTION") and option.fixed_type.identifier.startswith("ZOOMOUT"):
            found |= of_properties(option.fixed_type)
    return found


def registered():
    """What Blender knows of the add-on: labels, names and tooltips."""
    found = {each.bl_label for each in (*panels.CLASSES, *menus.CLASSES, *presets.CLASSES) if hasattr(each, "bl_label")}
    for name in dir(bpy.ops.zoomout):
        operator = getattr(bpy.ops.zoomout, name).get_rna_type()
        found |= {operator.name, operator.description} | of_properties(operator)
    return found | of_properties(bpy.types.Scene.bl_rna.properties["zoomout"].fixed_type)


def sources():
    rooms = panels, operators
    paths = [path for room in rooms for path in Path(room.__file__).parent.rglob("*.py")]
    paths += [Path(module.__file__) for module in (menus, preferences, preview)]
    return [node for path in paths for node in ast.walk(ast.parse(path.read_text()))]


def drawn():
    """Texts that panels and menus give to what they draw."""
    given = [node.value for node in sources() if isinstance(node, ast.keyword) and node.arg in ("text", "heading")]
    return {text.value for text in given if isinstance(text, ast.Constant)}


def literals():
    """All that stands between quotes in panels, menus and what previews are called."""
    return {node.value for node in sources() if isinstance(node, ast.Constant) and isinstance(node.value, str)}


@pytest.mark.parametrize("code", translations.LANGUAGES)
def test_nearly_everything_is_translated(code):
    messages = (registered() | drawn()) - {""} - NAMES
    missing = messages - translations.LANGUAGES[code].messages.keys()
    assert len(missing) < MOST_MISSING * len(messages), missing


@pytest.mark.parametrize("code", translations.LANGUAGES)
def test_no_translation_is_stale_or_empty(code):
    messages = translations.LANGUAGES[code].messages
    assert messages.keys() - registered() - literals() == set()
    assert all(messages.values())


def test_tooltips_end_alike():
    for messages, _ in translations.LANGUAGES.values():
        for english, text in messages.items():
            assert text.endswith(".") == english.endswith("."), english  # Blender adds the full stop
