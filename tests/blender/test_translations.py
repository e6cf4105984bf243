# SPDX-License-Identifier: GPL-3.0-or-later
"""Every text of the interface has a translation, and no translation is unused.

Labels and tooltips come from Blender's registry. Sentences are found in the code: literal arguments of calls that
create a Message or show text.
"""

from __future__ import annotations

import ast
import re
import string
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from shutil import which

import bpy
import pytest

import blender_addon
import zoomout_core
from blender_addon import operators, presets
from blender_addon.ui import menus, panels, preferences
from blender_addon.viewport import preview
from zoomout_core.transfer.keys.key_table import CONVENTIONS
from zoomout_core.translations import FOLDER, LANGUAGES, catalogue_of
from zoomout_core.translations.catalogue import read_catalogue

ADDON, CORE = (Path(package.__file__).parent for package in (blender_addon, zoomout_core))
# The same in every language.
NAMES = {"ZoomOut", menus.EXTENSION, "ESC", "X", "-X", "Y", "-Y", "Z", "-Z"}
NAMES |= {spelling.title for spelling in CONVENTIONS.values()}
# Languages in which every text has a translation. Others show the English text of what they lack.
COMPLETE = ("de",)
# The full stops of languages.
FULL_STOPS = (".", "。")
# Modules that print in English: the command lines, the demo, and functions for scripts.
ELSEWHERE = ("cli", "demo", "translations", "api.py", "assets", "batch.py", "evaluation.py")
# Modules of these that the add-on runs, or whose notes are on translated pages.
TRANSLATED = {
    CORE / "assets" / name for name in ("given_levels.py", "gltf/copy_rows.py", "gltf/convert_springs.py", "lods.py")
}
# Calls that make a Message of a template, or show text: all literals among their arguments are for the user.
TEMPLATES = {
    "LandmarkError",
    "MeshError",
    "NotEnoughMemoryError",
    "as_message",
    "message",
    "plural",
    "plural_warning",
    "sentences",
    "warning",
}
SHOWING = {"Finding", "is_available", "poll_message_set", "reported", "status_text_set", "translated"}
# Modules of the core whose stages and plain errors the add-on does not run into.
OF_CORE = (
    "library",
    "maps/surface_map.py",
    "matching/components/lift.py",
    "matching/components/main_parts.py",
    "matching/report/notes.py",
    "matching/pair.py",
    "matching/proximity.py",
    "matching/report/verdict.py",
    "symmetry/detect.py",
    "symmetry/mirror.py",
    "symmetry/offsets.py",
    "symmetry/self_map.py",
    "symmetry/uv.py",
    "transfer",
)
# Words that take another article or ending each in other languages are put into templates, see `zoomout_core.messages`.
ROLES = {"role": "source", "other": "target"}, {"role": "target", "other": "source"}
FIELD = re.compile(r"\{[a-z_0-9]+(:[^{}]*)?\}")


def of_properties(owner):
    """Names and tooltips of the properties of an operator or a group of settings."""
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


@cache
def registered():
    """The add-on's registered labels, names and tooltips."""
    found = {each.bl_label for each in (*panels.CLASSES, *menus.CLASSES, *presets.CLASSES) if hasattr(each, "bl_label")}
    for name in dir(bpy.ops.zoomout):
        operator = getattr(bpy.ops.zoomout, name).get_rna_type()
        found |= {operator.name, operator.description} | of_properties(operator)
    return found | of_properties(bpy.types.Scene.bl_rna.properties["zoomout"].fixed_type)


def drawn():
    """Literal texts drawn by panels and menus."""
    packages = panels, operators
    paths = [path for package in packages for path in Path(package.__file__).parent.rglob("*.py")]
    paths += [Path(module.__file__) for module in (menus, preferences, preview)]
    nodes = [node for path in paths for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))]
    given = [node.value for node in nodes if isinstance(node, ast.keyword) and node.arg in ("text", "heading")]
    return {text.value for text in given if isinstance(text, ast.Constant)}


@cache
def modules() -> list[tuple[Path, ast.Module]]:
    return [
        (path, ast.parse(path.read_text(encoding="utf-8")))
        for root in (ADDON, CORE)
        for path in sorted(root.rglob("*.py"))
        if path.relative_to(root).parts[0] not in ELSEWHERE or path in TRANSLATED
    ]


def texts_of(node: ast.AST) -> Iterator[str]:
    """A literal, or all texts of an f-string whose only values are roles."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif isinstance(node, ast.JoinedStr):
        for words in ROLES:
            parts = [
                part.value if isinstance(part, ast.Constant) else words.get(ast.unparse(part.value))
                for part in node.values
            ]
            if None not in parts:
                yield "".join(map(str, parts))


def literals_of(node: ast.AST) -> Iterator[str]:
    """All texts within a node but docstrings."""
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return
    yield from texts_of(node)
    for child in ast.iter_child_nodes(node):
        if not (isinstance(node, ast.JoinedStr) and isinstance(child, ast.Constant)):
            yield from literals_of(child)


@cache
def literals() -> set[str]:
    """All texts in the code."""
    return {text for _, tree in modules() for text in literals_of(tree)}


def words_of(text: str) -> str:
    """A text without its fields and punctuation."""
    return FIELD.sub("", text).strip(string.punctuation + string.whitespace)


def name_of(call: ast.Call) -> str:
    attribute = getattr(call.func, "attr", "")
    return "" if attribute == "warning" else attribute or getattr(call.func, "id", "")  # a logger's warning


@cache
def templates() -> set[str]:
    """Texts with fields and texts of Messages, all of which need a translation."""
    found = set()
    for path, tree in modules():
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and name_of(node) in TEMPLATES:
                plain = name_of(node).endswith("Error") and CORE in path.parents and not node.keywords
                found |= {text for argument in node.args for text in texts_of(argument) if not plain}
        found |= {text for text in literals_of(tree) if FIELD.search(text)}
    return {text for text in found if re.search("[a-z]{2}", words_of(text)) and " " in text}


@cache
def shown() -> set[str]:
    """Sentences without values that are shown as errors, notes, reasons or stages."""
    found = set()
    for path, tree in modules():
        in_core = CORE in path.parents
        if in_core and not path.relative_to(CORE).as_posix().startswith(OF_CORE):
            continue
        calls = SHOWING | {"stage", "append", "add", "MeshError"}
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and name_of(node) in calls:
                found |= {text for argument in node.args for text in literals_of(argument)}
            elif isinstance(node, ast.Return) and isinstance(node.value, ast.Constant):
                found |= {text for text in texts_of(node.value) if " " in text}
    return {text for text in found if re.search("[a-z]{2}", words_of(text)) and (" " in text or text[:1].isupper())}


def fields_of(text: str) -> list[tuple[str | None, str | None]]:
    """Fields with their formats, except the comma that separates thousands in English but not everywhere."""
    parsed = string.Formatter().parse(text)
    return sorted((name, (form or "").removesuffix(",")) for _, name, form, _ in parsed if name is not None)


@pytest.mark.parametrize("code", COMPLETE)
def test_labels_and_tooltips_are_translated(code):
    assert sorted((registered() | drawn()) - {""} - NAMES - catalogue_of(code).keys()) == []


@pytest.mark.parametrize("code", COMPLETE)
def test_templates_are_translated(code):
    assert sorted(templates() - catalogue_of(code).keys()) == []


@pytest.mark.parametrize("code", COMPLETE)
def test_sentences_without_values_are_translated(code):
    assert sorted(shown() - catalogue_of(code).keys()) == []


@pytest.mark.parametrize("code", LANGUAGES)
def test_dressing_is_translated_into_each_language(code):
    """Texts of the panel, and sentences of the service and of the report."""
    paths = [
        ADDON / "properties/dress.py",
        *(ADDON / "services/dressing").glob("*.py"),
        ADDON / "services/outfits.py",
        CORE / "matching/report/verdict.py",
        CORE / "collection/picture_page.py",
        *(CORE / "outfits").glob("*.py"),
        *(CORE / "assets/gltf" / name for name in ("append.py", "convert_springs.py")),
    ]
    texts = {text for path, tree in modules() if path in paths for text in literals_of(tree)}
    wanted = (templates() | registered()) & texts - NAMES - {""}
    assert len(wanted) > 50
    assert sorted(wanted - catalogue_of(code).keys()) == []


def test_counts_use_thousands_separators():
    plain = re.compile(r"\{count\} (of \{total\} )?(vertices|faces|triangles|edges|points|values)")
    assert list(filter(plain.search, templates())) == []


@pytest.mark.parametrize("code", LANGUAGES)
def test_no_translation_is_stale(code):
    assert sorted(catalogue_of(code).keys() - registered() - literals()) == []


@pytest.mark.parametrize("code", LANGUAGES)
def test_translations_have_the_fields_of_the_english(code):
    for english, text in catalogue_of(code).items():
        assert fields_of(text) == fields_of(english), english


@pytest.mark.parametrize("code", LANGUAGES)
def test_translations_end_like_the_english(code):
    for english, text in catalogue_of(code).items():
        assert text.endswith(FULL_STOPS) == english.endswith(FULL_STOPS), (
            english
        )  # Blender adds the full stop to tooltips


@pytest.mark.parametrize("code", LANGUAGES)
def test_catalogues_are_valid_gettext_files(code):
    path = FOLDER / f"{code}.po"
    content = path.read_text(encoding="utf-8")
    assert content.count("\nmsgid ") == len(catalogue_of(code)) + 1  # the header
    assert f'"Language: {code}\\n"' in content
    if which("msgfmt"):
        subprocess.run(["msgfmt", "--check", "--output-file=-", str(path)], check=True, capture_output=True)


CATALOGUE = r"""
msgid ""
msgstr "Language: xx\n"

# of a translator
#, python-brace-format
msgid ""
"'{name}' has \"faces\" "
"and edges"
msgstr ""
"'{name}' \n"
"x"

#, fuzzy
msgid "Doubtful"
msgstr "d"

msgid "Untranslated"
msgstr ""

#~ msgid "Old"
#~ msgstr "o"
"""


def test_catalogues_are_read(tmp_path):
    (tmp_path / "xx.po").write_text(CATALOGUE, encoding="utf-8")
    assert read_catalogue(tmp_path / "xx.po") == {"'{name}' has \"faces\" and edges": "'{name}' \nx"}


@pytest.mark.parametrize("line", ['msgctxt "Menu"', 'msgid_plural "b"', "msgid b", '"b"'])
def test_unsupported_catalogue_lines_are_refused(tmp_path, line):
    (tmp_path / "xx.po").write_text(f'{line}\nmsgid "a"\nmsgstr "b"\n', encoding="utf-8")
    with pytest.raises(ValueError, match="this line is not understood"):
        read_catalogue(tmp_path / "xx.po")
