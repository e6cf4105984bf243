# SPDX-License-Identifier: GPL-3.0-or-later
"""Messages composed at run time are shown in the user's language, including all their parts."""

from __future__ import annotations

import json
import pickle
import time
from types import SimpleNamespace
from typing import Any

import blf
import bpy
import pytest
from drawing import Context, Layout

import zoomout_core as zo
from blender_addon import translations
from blender_addon.mesh_data.attributes.marks import SEAMS
from blender_addon.operators.base import activity, modal_operator
from blender_addon.services import targets, transfer_report
from blender_addon.storage import stored_match, stored_report, stored_symmetry
from blender_addon.ui.panels import sidebar
from blender_addon.ui.panels.transfer import ZOOMOUT_PT_report
from zoomout_core.matching.pair import LandmarkError
from zoomout_core.messages import as_message, enumeration, from_json, message, sentences, to_json
from zoomout_core.runtime.progress import Progress
from zoomout_core.translations import in_language

NOT_A_MESH = message("'{name}' is not a mesh: choose a mesh object.", name="Body")
LEFT_OUT = message("'{name}' was left out: {reason}", name="Body", reason=NOT_A_MESH)
PLACED = message("'{name}', {number} of {count}: {title}", name="A", number=2, count=3, title=as_message("Refining"))
REPORT: dict[str, Any] = {
    "source": "A",
    "others": ["C"],
    "target": "B",
    "written": {"shape": ["shape"], "edges": [SEAMS], "uv_maps": []},
    "skipped": {message("symmetry"): "it maps the source mesh onto itself", "Mask": "it is internal to Blender"},
    "notes": [LEFT_OUT],
    "vertices": 9,
    "low_confidence": 3,
}
COMPOSED = {
    message("Exchanged the sides of {what}", what=enumeration([SEAMS, "seams"])): "Seiten ausgetauscht: Nähte, seams",
    LEFT_OUT: "'Body' wurde ausgelassen: 'Body' ist kein Mesh: ein Mesh-Objekt wählen.",
    PLACED: "'A', 2 von 3: Verfeinern",
    message("{layer}: {count:,} of {total:,} faces have flipped UVs.", layer="UVMap", count=3, total=90): (
        "UVMap: 3 von 90 Flächen haben umgekehrte UVs."
    ),
    message("{layer}: {count:,} edges of the source belong to no face and were left out.", layer=SEAMS, count=3): (
        "Nähte: 3 Kanten der Quelle gehören zu keiner Fläche und wurden ausgelassen."
    ),
    stored_symmetry.summary({"name": "Reflection", "certainty": 0.95}): "Spiegelung, 95%",
    transfer_report.summary(REPORT): (
        "1 Form, 1 Art von Kantenmarkierung übertragen, von 'A' und 1 weiteren auf 'B'; 2 ausgelassen; "
        "3 von 9 Vertices sind zweifelhaft"
    ),
    transfer_report.summarise_targets([REPORT | {"bound": {"armature": "Rig", "shape": "rest_pose"}}], hidden=True): (
        "'B' ist an 'Rig' gebunden, in der Ruheposition am Ort der Quelle; die Quelle ist ausgeblendet"
    ),
    sentences(NOT_A_MESH, "Make a mesh active.", "Unknown words follow."): (
        "'Body' ist kein Mesh: ein Mesh-Objekt wählen. Ein Mesh aktiv machen. Unknown words follow."
    ),
    message("{vertices} is used {vertices} times", vertices=1): "1 is used 1 times",
    message("The mesh '{mesh}' is shared by {users} objects, which all received the data.", mesh="{users}", users=2): (
        "2 Objekte teilen sich das Mesh '{users}'; alle haben die Daten erhalten."
    ),
}


@pytest.mark.parametrize("english", COMPOSED)
def test_composed_messages_are_translated_with_their_parts(english: str) -> None:
    assert in_language(english, "de") == in_language(english, "de_DE") == COMPOSED[english]


@pytest.mark.parametrize(
    "passed",
    [
        lambda text: str(zo.MeshError(text)),
        lambda text: pickle.loads(pickle.dumps(text)),
        lambda text: str(pickle.loads(pickle.dumps(zo.MeshError(text)))),
        lambda text: from_json(json.loads(json.dumps(to_json(text)))),
    ],
    ids=["an exception", "pickle", "an exception in pickle", "JSON"],
)
def test_messages_are_translated_after_serialisation(passed) -> None:
    for english, german in COMPOSED.items():
        assert in_language(passed(english), "de") == german


def test_errors_about_landmarks_have_the_article_of_their_mesh() -> None:
    fault = message("at vertex {vertex}, is not on its main part: move it.", vertex=3)
    shown = [in_language(str(LandmarkError(role, 2, fault)), "de") for role in ("source", "target")]
    assert shown == [
        "Landmarke 2 auf der Quelle, bei Vertex 3, liegt nicht auf dessen Hauptteil: verschieben.",
        "Landmarke 2 auf dem Ziel, bei Vertex 3, liegt nicht auf dessen Hauptteil: verschieben.",
    ]


def test_failures_of_several_targets_are_translated() -> None:
    failed = {"A": NOT_A_MESH, "B": "Make a mesh active."}
    with pytest.raises(zo.MeshError) as caught:
        targets.Outcome({}, failed).check()
    german = "Alle 2 Ziele sind misslungen. 'A': 'Body' ist kein Mesh: ein Mesh-Objekt wählen."
    assert in_language(str(caught.value), "de") == german


@pytest.mark.parametrize("name", ["Target", "Mask", "seams", "Bob's head", "shape keys", "{reason}"])
def test_names_are_not_translated(name: str) -> None:
    """Even if labels and nouns of the catalogue are the same words."""
    text = message("'{name}' is not a mesh: choose a mesh object.", name=name)
    assert in_language(text, "de") == f"'{name}' ist kein Mesh: ein Mesh-Objekt wählen."


@pytest.mark.parametrize("text", ["", "Whatever else: it stays.", "An unknown shape", "Unknown, and 3 of {}"])
def test_unknown_text_stays_english(text: str) -> None:
    assert in_language(text, "de") == in_language(as_message(text), "de") == text


def test_other_languages_stay_english() -> None:
    text = "Make a mesh active."
    assert in_language(text, "de") != text
    assert {in_language(text, code) for code in ("", "en_US", "fr_FR", "d")} == {text}


@pytest.mark.parametrize("interface", [True, False])
@pytest.mark.parametrize("reports", [True, False])
def test_user_settings_control_translation(interface: bool, reports: bool, monkeypatch: pytest.MonkeyPatch) -> None:
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
    """Set the user's language; Blender as a Python module has no languages."""
    monkeypatch.setattr(translations, "user_language", lambda setting: "de_DE")


def labels(text: str, width: int) -> list[str]:
    """The lines of a sentence in a panel."""
    everything: list[tuple[str, str, object]] = []
    context = Context()
    context.region = SimpleNamespace(width=width)
    sidebar.sentences(context, Layout(everything), [text])
    return [line for kind, line, _ in everything if kind == "label"]


def test_sentences_are_wrapped_in_the_users_language(in_german: None) -> None:
    lines = labels(message("The source '{source}' was edited after the match: match again.", source="Body"), 300)
    assert len(lines) > 1
    assert max(blf.dimensions(sidebar.FONT, line)[0] for line in lines) <= 300 - sidebar.BORDER
    assert " ".join(lines) == "Die Quelle 'Body' wurde nach der Zuordnung bearbeitet: erneut zuordnen."


def test_progress_is_shown_in_the_users_language(in_german: None, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str | None] = []
    everything: list[tuple[str, str, object]] = []
    monkeypatch.setattr(activity, "running", None)
    context = SimpleNamespace(workspace=SimpleNamespace(status_text_set=said.append))
    modal_operator._show_progress(context, Progress(0.5, PLACED))
    sidebar.main_button(Layout(everything), "zoomout.match", "Match", "NONE", True)
    assert said == ["'A', 2 von 3: Verfeinern: 50% (ESC bricht ab)"]
    assert ("progress", "'A', 2 von 3: Verfeinern") in [entry[:2] for entry in everything]
    modal_operator._show_progress(context, None)
    assert said[1:] == [None]


def test_operators_report_in_the_users_language(target: bpy.types.Object, in_german: None) -> None:
    target.data.clear_geometry()
    with pytest.raises(RuntimeError, match="'Target' hat keine Flächen: ein Mesh mit einer Oberfläche wählen"):
        bpy.ops.zoomout.match()


def test_stored_messages_are_shown_in_the_users_language(target: bpy.types.Object, in_german: None) -> None:
    assert bpy.ops.zoomout.match(initial="NEAREST") == {"FINISHED"}
    assert bpy.ops.zoomout.transfer(shape=True) == {"FINISHED"}
    report = stored_report.transfer_report(target)
    notes = [*stored_match.description(target.data)["notes"], *report["notes"], transfer_report.summary(report)]
    assert transfer_report.summary(report).startswith("Transferred 1 attribute, 1 shape from 'Source'")
    german = "1 Attribut, 1 Form übertragen, von 'Source' auf 'Target'; 0 von"
    assert in_language(transfer_report.summary(report), "de").startswith(german)
    assert all(in_language(note, "de") != note for note in notes)


def test_reports_list_skipped_data_in_the_users_language(target: bpy.types.Object, in_german: None) -> None:
    stored_report.write(target, REPORT)
    assert lines_of_report(target)[-3:] == [
        "Symmetrie: ausgelassen, sie bildet das Quell-Mesh auf sich selbst ab",
        "Mask: ausgelassen, es ist Blender-intern",
        "'Body' wurde ausgelassen: 'Body' ist kein Mesh: ein Mesh-Objekt wählen.",
    ]


def test_reports_of_earlier_versions_are_shown(target: bpy.types.Object, in_german: None) -> None:
    """They are shown in English, except for sentences without values."""
    notes = ["3 of 90 faces have flipped UVs.", "Make a mesh active."]
    target.data[stored_report.PROPERTY] = json.dumps(REPORT | {"skipped": {"symmetry": "no reason"}, "notes": notes})
    assert lines_of_report(target)[-3:] == [
        "symmetry: ausgelassen, no reason",
        "3 of 90 faces have flipped UVs.",
        "Ein Mesh aktiv machen.",
    ]


def test_report_with_damaged_message_is_ignored(target: bpy.types.Object) -> None:
    stored_report.write(target, REPORT)
    target.data[stored_report.PROPERTY] = target.data[stored_report.PROPERTY].replace("{reason}", "{reason:>999999999}")
    assert stored_report.transfer_report(target) is None


def lines_of_report(target: bpy.types.Object) -> list[str]:
    """The sentences of the report's panel."""
    everything: list[tuple[str, str, object]] = []
    context = Context()
    context.region = SimpleNamespace(width=10000)
    bpy.context.view_layer.objects.active = target
    panel = SimpleNamespace(layout=Layout(everything))
    ZOOMOUT_PT_report.draw(panel, context)
    return [line for kind, line, _ in everything if kind == "label"]


def test_translating_panels_is_fast(in_german: None) -> None:
    """Less than a millisecond for more sentences than panels ever show."""
    text = "The source '{source}' was edited after the match: match again."
    texts = [message(text, source=f"Body {number}") for number in range(50)]
    taken = []
    for _ in range(10):
        begin = time.process_time()
        for text in texts:
            translations.translated(text)
        taken.append(time.process_time() - begin)
    assert min(taken) < 1e-3
