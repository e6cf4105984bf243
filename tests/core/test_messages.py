# SPDX-License-Identifier: GPL-3.0-or-later
"""Messages are English text that keeps its template and values when copied, pickled or saved."""

from __future__ import annotations

import copy
import json
import pickle
from pathlib import Path

import numpy as np
import pytest

import zoomout_core as zo
from zoomout_core.messages import (
    MESSAGE,
    Message,
    as_message,
    enumeration,
    from_json,
    is_warning,
    message,
    note_figures,
    note_lines,
    plural,
    plural_warning,
    probability,
    sentences,
    to_json,
    warning,
)

LEFT_OUT = message("'{name}' was left out: {reason}", name="A", reason=message("{share:.0%} is missing", share=0.25))


def parts(text: str) -> object:
    """A Message as its template and values, recursively; other values unchanged."""
    return (text.template, {name: parts(value) for name, value in text.values.items()}) if is_message(text) else text


def is_message(value: object) -> bool:
    return isinstance(value, Message)


def test_message_equals_its_english_text() -> None:
    assert LEFT_OUT == "'A' was left out: 25% is missing"
    assert f"{LEFT_OUT}!" == "'A' was left out: 25% is missing!"
    assert hash(LEFT_OUT) == hash("'A' was left out: 25% is missing")


@pytest.mark.parametrize(
    "passed",
    [
        str,
        copy.copy,
        copy.deepcopy,
        lambda text: pickle.loads(pickle.dumps(text)),
        lambda text: from_json(json.loads(json.dumps(to_json(text)))),
        lambda text: str(zo.MeshError(text)),
        lambda text: zo.MeshError(text).args[0],
        lambda text: str(pickle.loads(pickle.dumps(zo.MeshError(text)))),
    ],
)
def test_template_and_values_survive_copying_and_storage(passed) -> None:
    assert parts(passed(LEFT_OUT)) == parts(LEFT_OUT)


@pytest.mark.parametrize(
    "passed",
    [
        copy.deepcopy,
        lambda text: pickle.loads(pickle.dumps(text)),
        lambda text: from_json(json.loads(json.dumps(to_json(text)))),
    ],
)
def test_warnings_stay_warnings(passed) -> None:  # type: ignore[no-untyped-def]
    note, warns = message("{count} are hidden", count=2), warning("{count} are torn: check these", count=3)
    assert warns == "3 are torn: check these"
    assert is_warning(passed(warns))
    assert not is_warning(passed(note))
    assert not is_warning("plain text")


def test_warnings_are_printed_first_and_listed_in_figures() -> None:
    note, warns = message("{count} are hidden.", count=2), warning("{count} are torn.", count=3)
    assert note_lines(iter([note, warns, "Plain."])) == ["Warning: 3 are torn.", "2 are hidden.", "Plain."]
    assert note_figures(iter([note, warns])) == {"notes": [note, warns], "warnings": [warns]}


def test_values_are_converted_to_json_types() -> None:
    made = message(
        "{count:,} {share:.1f} {path} {found}", count=np.int64(1200), share=np.float32(0.5), path=Path("a"), found=None
    )
    assert made == "1,200 0.5 a None"
    assert made.values == {"count": 1200, "share": 0.5, "path": "a", "found": "None"}
    assert from_json(json.loads(json.dumps(to_json(made)))) == made


def test_an_error_with_values_is_a_message() -> None:
    error = zo.MeshError("'{name}' has {count} faces.", name="A", count=3)
    assert parts(str(error)) == ("'{name}' has {count} faces.", {"name": "A", "count": 3})
    assert parts(str(zo.MeshError("{} is text."))) == ("{{}} is text.", {})


def test_joined_messages_keep_their_parts() -> None:
    both = sentences("First.", LEFT_OUT)
    assert both == "First. 'A' was left out: 25% is missing"
    assert [parts(value) for value in both.values.values()] == [("First.", {}), parts(LEFT_OUT)]
    assert enumeration(["Target", message("seams")]) == "Target, seams"
    assert [is_message(value) for value in enumeration(["Target", message("seams")]).values.values()] == [False, True]
    assert enumeration([]) == ""


@pytest.mark.parametrize(
    ("value", "text"), [(0.0, "under 1%"), (0.42, "42%"), (0.99, "99%"), (0.9979, "over 99%"), (1.0, "over 99%")]
)
def test_a_probability_is_never_rounded_to_certainty(value: float, text: str) -> None:
    assert probability(value) == text


@pytest.mark.parametrize(("count", "text"), [(0, "0 meshes"), (1, "1 mesh"), (2, "2 meshes")])
def test_plural_chooses_the_template_by_count(count: int, text: str) -> None:
    assert plural(count, "1 mesh", "{count} meshes") == text


def test_plural_fills_in_other_values_and_marks_warnings() -> None:
    templates = "'{name}': check 1 vertex.", "'{name}': check {count:,} vertices."
    for choose, marked in ((plural, False), (plural_warning, True)):
        assert choose(1, *templates, name="Hero") == "'Hero': check 1 vertex."
        assert choose(1200, *templates, name="Hero") == "'Hero': check 1,200 vertices."
        assert is_warning(choose(2, *templates, name="Hero")) == marked


def test_text_of_earlier_versions_is_unchanged() -> None:
    old = {"notes": ["Hints used: 3 landmarks."], "vertices": 9, "without_partner": None}
    assert from_json(json.loads(json.dumps(to_json(old)))) == old
    assert as_message("50% of {this}") == "50% of {this}"


def test_nested_messages_are_stored() -> None:
    report = {"notes": (LEFT_OUT, "plain"), "skipped": {message("seams"): LEFT_OUT}}
    stored = from_json(json.loads(json.dumps(to_json(report))))
    assert stored == {"notes": [LEFT_OUT, "plain"], "skipped": {"seams": LEFT_OUT}}
    assert parts(stored["notes"][0]) == parts(stored["skipped"]["seams"]) == parts(LEFT_OUT)
    assert all(map(is_message, stored["skipped"]))


@pytest.mark.parametrize(
    "stored",
    [
        None,
        ["{name}"],
        [3, {}],
        ["{name}", []],
        ["{name}", {}],
        ["{name.__class__}", {"name": "A"}],
        ["{name[0]}", {"name": "A"}],
        ["{name!r}", {"name": "A"}],
        ["{name:>999999999}", {"name": "A"}],
        ["{name:>{wide}}", {"name": "A", "wide": 999999999}],
        ["{name", {"name": "A"}],
        ["{name:d}", {"name": "A"}],
    ],
)
def test_damaged_messages_are_rejected(stored: object) -> None:
    with pytest.raises((ValueError, TypeError, KeyError)):
        from_json({MESSAGE: stored})
