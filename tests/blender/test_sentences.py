# SPDX-License-Identifier: GPL-3.0-or-later
"""What is composed while the add-on works is translated as whole sentences, and every sentence has its translation."""

from __future__ import annotations

import ast
import re
import string
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest
from drawing import Context, Layout

import blender_addon
import zoomout_core
from blender_addon import translations
from blender_addon.operators import activity, modal_operator
from blender_addon.services import transfer
from blender_addon.storage import stored_match, stored_report
from blender_addon.translations import in_language
from blender_addon.ui.panels import sidebar
from zoomout_core.runtime.progress import Progress

# A language that lacks more is no help: whoever adds sentences may leave a few to those who know it.
MOST_MISSING = 0.1
ADDON, CORE = (Path(package.__file__).parent for package in (blender_addon, zoomout_core))
# What is said at the command line, or by the demo, and the tables themselves.
ELSEWHERE = ("cli", "demo", "translations", "api.py")
# What Blender's panels can run into of the core: other errors are about arguments that the add-on sets itself.
OF_CORE = (
    "maps/surface_map.py",
    "matching/components/lift.py",
    "matching/components/main_parts.py",
    "matching/notes.py",
    "matching/pair.py",
    "matching/proximity.py",
    "symmetry/detect.py",
    "symmetry/mirror.py",
    "symmetry/offsets.py",
    "symmetry/self_map.py",
    "symmetry/uv.py",
    "transfer",
)
# Calls whose arguments are said to the user.
SAYING = {
    "Finding",
    "Kind",
    "LandmarkError",
    "MeshError",
    "Progress",
    "add",
    "append",
    "poll_message_set",
    "report",
    "reported",
    "sentences",
    "stage",
    "status_text_set",
    "translated",
}
# What such calls are given besides: names of files, keys and icons, and what only scripts can do wrong.
NOT_SAID = {"BLANK1", "CHECKMARK", "DOT", "ERROR", "INFO", "WARNING", "MOUSEMOVE"}


def text_of(node: ast.AST) -> str | None:
    """A literal or f-string with `{}` for each value, or None."""
    if isinstance(node, ast.Constant):
        return re.sub(r"{[^{}]*}", "{}", node.value) if isinstance(node.value, str) else None
    if isinstance(node, ast.JoinedStr):
        parts = (part.value if isinstance(part, ast.Constant) else "{}" for part in node.values)
        return "".join(map(str, parts))
    return None


def literals_of(node: ast.AST) -> Iterator[str]:
    """All texts within a node; those that stand within f-strings, in their braces, are texts of their own."""
    text = text_of(node)
    if text is not None:
        yield text
    for child in ast.iter_child_nodes(node):
        if not (isinstance(node, ast.JoinedStr) and isinstance(child, ast.Constant)):
            yield from literals_of(child)


def modules() -> Iterator[tuple[Path, ast.Module]]:
    for root in (ADDON, CORE):
        for path in sorted(root.rglob("*.py")):
            if path.relative_to(root).parts[0] not in ELSEWHERE:
                yield path, ast.parse(path.read_text(encoding="utf-8"))


def literals() -> set[str]:
    """All texts that stand in the code."""
    return {text for _, tree in modules() for text in literals_of(tree)}


def is_said(text: str) -> bool:
    """Whether a text has words of its own that are no identifier."""
    own = text.replace("{}", "").strip(string.punctuation + " ")
    return own not in NOT_SAID and re.search("[a-z]{2}", own) is not None and (" " in own or own[:1].isupper())


def outside_errors_of_python(tree: ast.AST) -> Iterator[ast.AST]:
    """The nodes of a module but those that make errors which only scripts run into, such as a ValueError."""
    yield tree
    for child in ast.iter_child_nodes(tree):
        if not (isinstance(child, ast.Call) and getattr(child.func, "id", "") in ("TypeError", "ValueError")):
            yield from outside_errors_of_python(child)


def said() -> set[str]:
    """Texts that are returned, named, or given to calls that say something, and all f-strings: most sentences."""
    found = set()
    for path, tree in modules():
        if CORE in path.parents and not path.relative_to(CORE).as_posix().startswith(OF_CORE):
            continue
        for node in outside_errors_of_python(tree):
            if isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) in SAYING:
                found |= {text for argument in node.args for text in literals_of(argument)}
            elif isinstance(node, ast.JoinedStr):
                found.add(text_of(node))
            elif isinstance(node, ast.Return | ast.Assign) and isinstance(node.value, ast.Constant):
                found |= {text for text in literals_of(node.value) if " " in text and "\n" not in text}
    return {text for text in found if is_said(text)}


def without_name(text: str) -> str:
    """A sentence without the name of what it is about."""
    return text.removeprefix("{}: ")


def specialises(key: str, text: str, every: set[str]) -> bool:
    """Whether a key of a table is a text, or one in which words of the code stand for some of its values."""
    if key == text:
        return True
    if "{}" not in text or len(text.replace("{}", "")) < 8:
        return False
    match = re.fullmatch("(.*?)".join(map(re.escape, text.split("{}"))), key)
    words = {value.removeprefix("{}") for value in match.groups()} if match else set()
    return match is not None and all(not re.search("[a-z]", value) or value in every for value in words)


def is_covered(text: str, keys: set[str], every: set[str]) -> bool:
    """Whether a text has a translation, as a whole, or without its full stop or the name of what it is about."""
    forms = {text, text.removesuffix("."), without_name(text)}
    return bool(forms & keys) or any(specialises(key, form, every) for key in keys for form in forms)


@pytest.mark.parametrize("code", translations.LANGUAGES)
def test_nearly_every_sentence_is_translated(code: str) -> None:
    every, language = literals(), translations.LANGUAGES[code]
    keys = {*language.sentences, *language.messages}
    texts = said()
    missing = sorted(text for text in texts if not is_covered(text, keys, every))
    assert len(missing) < MOST_MISSING * len(texts), "\n".join(missing)


@pytest.mark.parametrize("code", translations.LANGUAGES)
def test_no_sentence_is_stale_or_empty(code: str) -> None:
    every, sentences = literals(), translations.LANGUAGES[code].sentences
    forms = {form for text in every for form in (text, without_name(text))}
    assert [key for key in sentences if not any(specialises(key, form, every) for form in forms)] == []
    assert all(sentences.values())


@pytest.mark.parametrize("code", translations.LANGUAGES)
def test_translations_have_the_values_of_the_sentence(code: str) -> None:
    for english, text in translations.LANGUAGES[code].sentences.items():
        places = [field for _, field, *_ in string.Formatter().parse(text) if field is not None]
        count = english.count("{}")
        assert sorted(places) in ([""] * count, sorted(map(str, range(count)))), english
        assert english.endswith(".") == text.endswith("."), english


@pytest.mark.parametrize("code", translations.LANGUAGES)
def test_a_table_translates_its_own_sentences(code: str) -> None:
    """Each is found again with values in it, and not taken for another one."""
    for english, text in translations.LANGUAGES[code].sentences.items():
        values = [f"{number + 1}" for number in range(english.count("{}"))]
        assert in_language(english.format(*values), code) == text.format(*values)


COMPOSED = {
    "Switch to Edit Mode.": "In den Bearbeitungsmodus wechseln.",
    "'A', 2 of 3: Transferring vertex groups": "'A', 2 von 3: Punktgruppen übertragen",
    "UVMap: 3 of 90 faces have flipped UVs.": "UVMap: 3 von 90 Flächen haben umgekehrte UVs.",
    "sharp edges: 3 edges of the source belong to no face and were left out.": (
        "scharfe Kanten: 3 Kanten der Quelle gehören zu keiner Fläche und wurden ausgelassen."
    ),
    "Reflection, 95%": "Spiegelung, 95%",
    "Found 2 symmetries of 'X'; the first: Half turn, 60%": (
        "2 Symmetrien von 'X' gefunden; die erste: Halbe Drehung, 60%"
    ),
    "Hints used: 3 landmarks, the same up axis.": "Benutzte Anhaltspunkte: 3 Landmarken, gleiche Hochachse.",
    "Show Matching Colors": "Gleiche Farben zeigen",
    "Without a partner: 3 faces of 'A', 1.0% of its area; no vertices of 'B', 0.0% of its area": (
        "Ohne Gegenstück: 3 Flächen von 'A', 1.0% der Oberfläche; keine Vertices von 'B', 0.0% der Oberfläche"
    ),
    "Doubtful: 3 vertices of 'A', 1.0% of its area": "Zweifelhaft: 3 Vertices von 'A', 1.0% der Oberfläche",
    "Cleared 1 mesh and 3 landmarks": "Zuordnungsdaten entfernt: 1 Mesh und 3 Landmarken",
    "Transferred 1 shape from 'A' to 'B'; 0 of 9 vertices are of low confidence; Transferred 1 shape from 'A' to 'C'; "
    "2 skipped; 0 of 9 vertices are of low confidence": (
        "1 Form übertragen, von 'A' auf 'B'; 0 von 9 Vertices sind unsicher; 1 Form übertragen, von 'A' auf 'C'; "
        "2 ausgelassen; 0 von 9 Vertices sind unsicher"
    ),
    "Matched 'X' with 'Y' and others; 3 of 9 vertices are of low confidence; 5% of the target and 0% of the source "
    "have no partner": (
        "'X' zugeordnet, Quelle 'Y' und andere; 3 von 9 Vertices sind unsicher; 5% des Ziels und 0% der Quelle haben "
        "kein Gegenstück"
    ),
    "The existing match was used: to apply the changed settings (Detail, Method), match again.": (
        "Die vorhandene Zuordnung wurde benutzt: um die geänderten Einstellungen (Feinheit, Verfahren) anzuwenden, "
        "erneut zuordnen."
    ),
    "The largest part of the target has only 7 vertices, too few for matching: subdivide it to at least 50.": (
        "Der größte Teil des Ziels hat nur 7 Vertices, zu wenige zum Zuordnen: auf mindestens 50 unterteilen."
    ),
    "'Body' was left out: 'Body' is not a mesh: choose a mesh object.": (
        "'Body' wurde ausgelassen: 'Body' ist kein Mesh: ein Mesh-Objekt wählen."
    ),
}


@pytest.mark.parametrize("english", COMPOSED)
def test_what_is_composed_is_translated_with_its_parts(english: str) -> None:
    assert in_language(english, "de") == in_language(english, "de_DE") == COMPOSED[english]


def test_sentences_side_by_side_are_translated_each() -> None:
    source, target = (
        "The source 'A' was edited after the match: match again.",
        "The target 'B' was edited after the match: match again.",
    )
    german = " ".join(in_language(text, "de") for text in (source, target))
    assert in_language(f"{source} {target}", "de") == german
    assert in_language(f"{source} Unknown words follow.", "de") == f"{in_language(source, 'de')} Unknown words follow."
    assert "{}" not in german


def test_a_value_does_not_reach_into_the_next_sentence() -> None:
    shared = "The mesh '{}' is shared by {} objects, which all received the data."
    german = (
        "2 Objekte teilen sich das Mesh 'A'; alle haben die Daten erhalten. 3 Objekte teilen sich das Mesh 'B'; alle"
    )
    assert in_language(f"{shared.format('A', 2)} {shared.format('B', 3)}", "de").startswith(german)


def test_names_stay_as_they_are() -> None:
    """Though labels and nouns of the tables are the same words."""
    for name in ("Target", "Mask", "seams", "Bob's head", "shape keys"):
        assert in_language(f"'{name}' is not a mesh: choose a mesh object.", "de").startswith(f"'{name}' ist kein")
    assert in_language("Mask: 3 of 90 faces have flipped UVs.", "de").startswith("Mask: 3 von")
    assert in_language("Mask: skipped, it is internal to Blender", "de").startswith("Mask: ausgelassen, es ist")


@pytest.mark.parametrize("text", ["", "Whatever else: it stays.", "An unknown shape", "Unknown, and 3 of {}"])
def test_what_has_no_translation_stays_english(text: str) -> None:
    assert in_language(text, "de") == text


def test_other_languages_stay_english() -> None:
    text = "Make a mesh active."
    assert in_language(text, "de") != text
    assert {in_language(text, code) for code in ("", "en_US", "fr_FR", "d")} == {text}


@pytest.mark.parametrize("interface", [True, False])
@pytest.mark.parametrize("reports", [True, False])
def test_settings_of_the_user_decide(interface: bool, reports: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    def blender(**settings: bool) -> SimpleNamespace:
        context = SimpleNamespace(preferences=SimpleNamespace(view=SimpleNamespace(**settings)))
        return SimpleNamespace(app=SimpleNamespace(translations=SimpleNamespace(locale="de_DE")), context=context)

    english, german = "Make a mesh active.", "Ein Mesh aktiv machen."
    both = blender(use_translate_interface=interface, use_translate_reports=reports)
    monkeypatch.setattr(translations, "bpy", both)
    assert translations.translated(english) == (german if interface else english)
    assert translations.reported(english) == (german if reports else english)
    monkeypatch.setattr(translations, "bpy", blender(use_translate_interface=interface))  # of an older Blender
    assert translations.reported(english) == (german if interface else english)


@pytest.fixture
def in_german(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the user has chosen; Blender as a Python module has no languages."""
    monkeypatch.setattr(translations, "user_language", lambda setting: "de_DE")


def labels(text: str, width: int) -> list[str]:
    """The lines that a sentence takes in a panel."""
    everything: list[tuple[str, str, object]] = []
    context = Context()
    context.region = SimpleNamespace(width=width)
    sidebar.sentences(context, Layout(everything), [text])
    return [line for kind, line, _ in everything if kind == "label"]


def test_sentences_are_wrapped_in_the_language_that_is_read(in_german: None) -> None:
    lines = labels("The source 'Body' was edited after the match: match again.", 300)
    assert len(lines) > 1
    assert max(map(len, lines)) <= (300 - sidebar.BORDER) / sidebar.LETTER
    assert " ".join(lines) == "Die Quelle 'Body' wurde nach der Zuordnung bearbeitet: erneut zuordnen."


def test_progress_is_shown_in_the_language_that_is_read(in_german: None, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str | None] = []
    everything: list[tuple[str, str, object]] = []
    monkeypatch.setattr(activity, "running", None)
    context = SimpleNamespace(workspace=SimpleNamespace(status_text_set=said.append))
    modal_operator._show_progress(context, Progress(0.5, "'A', 2 of 3: Refining"))
    sidebar.main_button(Layout(everything), "zoomout.match", "Match", "NONE", True)
    assert said == ["'A', 2 von 3: Verfeinern: 50% (ESC bricht ab)"]
    assert ("progress", "'A', 2 von 3: Verfeinern") in [entry[:2] for entry in everything]
    modal_operator._show_progress(context, None)
    assert said[1:] == [None]


def test_operators_report_in_the_language_that_is_read(target: bpy.types.Object, in_german: None) -> None:
    target.data.clear_geometry()
    with pytest.raises(RuntimeError, match="'Target' hat keine Flächen: ein Mesh mit einer Oberfläche wählen"):
        bpy.ops.zoomout.match()


def test_what_is_stored_is_english(target: bpy.types.Object, in_german: None) -> None:
    assert bpy.ops.zoomout.match(initial="NEAREST") == {"FINISHED"}
    assert bpy.ops.zoomout.transfer(shape=True) == {"FINISHED"}
    report = stored_report.transfer_report(target)
    notes = [*stored_match.description(target.data)["notes"], *report["notes"], transfer.summary(report)]
    assert transfer.summary(report).startswith("Transferred 1 attribute, 1 shape from 'Source'")
    german = "1 Attribut, 1 Form übertragen, von 'Source' auf 'Target'; 0 von"
    assert in_language(transfer.summary(report), "de").startswith(german)
    assert all(in_language(note, "de") != note for note in notes)


def test_panels_are_drawn_as_fast(in_german: None) -> None:
    """What is shown again and again is looked up once: less than a millisecond for more than panels ever show."""
    texts = [f"The source 'Body {number}' was edited after the match: match again." for number in range(50)]
    for text in texts:
        translations.translated(text)
    begin = time.perf_counter()
    for text in texts:
        translations.translated(text)
    assert time.perf_counter() - begin < 1e-3
