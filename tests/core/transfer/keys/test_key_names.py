# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of expression keys: the table is consistent, spellings are recognised, and nothing is renamed by guessing."""

from __future__ import annotations

import numpy as np
import pytest

import zoomout_core as zo
from zoomout_core.transfer.keys import key_names, key_words
from zoomout_core.transfer.keys.key_names import describe
from zoomout_core.transfer.keys.key_table import CONVENTIONS, read_table

ARKIT = zo.key_names("arkit")
SIZES = {
    "arkit": 52,
    "unified": 116,
    "metahuman": 239,
    "makehuman": 34,
    "oculus": 15,
    "vrchat": 15,
    "vrm0": 17,
    "vrm1": 18,
}


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_a_convention_is_complete_and_recognised(convention: str) -> None:
    names = zo.key_names(convention)
    assert len(names) == len(set(names)) == SIZES[convention]
    assert zo.recognise_key_names(names) == convention
    same = zo.translate_key_names(names, convention)
    assert same.renamed == dict(zip(names, names, strict=True))
    assert (same.composed, same.missing) == ({}, ())


def test_sums_use_keys_of_their_convention() -> None:
    """The first keys of a cell are those that are written; other spellings, such as ARKit's split keys, are read."""
    for row in read_table():
        for convention, cell in row.items():
            if not cell.written:
                assert set(cell.sums[0]) <= set(zo.key_names(convention)) or convention == "arkit", cell


def test_keys_of_the_left_side_have_partners_on_the_right() -> None:
    """A row for one side only would be an oversight in the table."""
    for left, right in (("Left", "Right"), ("left", "right")):
        for convention in ("arkit", "unified", "makehuman", "vrm1"):
            names = set(zo.key_names(convention))
            assert {name.replace(left, right) for name in names} <= names


@pytest.mark.parametrize(
    "spelling",
    [
        lambda name: name.replace("Left", "_L").replace("Right", "_R"),
        lambda name: name.replace("Left", ".L").replace("Right", ".R"),
        lambda name: name[0].upper() + name[1:],
        lambda name: f"blendShape1.{name}",
        lambda name: f"Head|head_geo.{name.replace('Left', '_L').replace('Right', '_R')}",
        lambda name: f"Wolf3D_Head_{name}",
        lambda name: f"{name}.001",
        str.upper,
    ],
)
def test_spellings_and_prefixes_do_not_matter(spelling) -> None:  # type: ignore[no-untyped-def]
    names = ["Basis", *(spelling(name) for name in ARKIT), "Corrective 12"]
    assert zo.recognise_key_names(names) == "arkit"
    assert zo.translate_key_names(names, "arkit").renamed == dict(zip(names[1:-1], ARKIT, strict=True))


def test_visemes_are_recognised_by_their_prefixes() -> None:
    for prefix, convention in (("viseme_", "oculus"), ("", "oculus"), ("vrc.v_", "vrchat")):
        names = [prefix + name for name in ("sil", "PP", "FF", "TH", "DD", "kk", "CH", "SS", "nn", "RR", "aa", "E")]
        assert zo.recognise_key_names(names) == convention, prefix
    assert zo.translate_key_names(["viseme_ih", "viseme_aa", "viseme_PP"], "vrchat").renamed == {
        "viseme_ih": "vrc.v_ih",
        "viseme_aa": "vrc.v_aa",
        "viseme_PP": "vrc.v_pp",
    }


@pytest.mark.parametrize("names", [[], ["a"], ["Key 1", "Key 2", "Smile"], ["jawOpen", "Muscle", "Fat", "Thin", "Old"]])
def test_few_or_unknown_names_match_no_convention(names: list[str]) -> None:
    assert zo.recognise_key_names(names) is None
    keys = zo.translate_key_names(names, "unified")
    assert (keys.sources, keys.renamed, keys.composed) == ((), {}, {})
    assert len(keys.missing) == SIZES["unified"]
    assert "no known convention" in describe(keys)[0]


def test_expressions_and_visemes_of_one_avatar_are_both_renamed() -> None:
    visemes = [f"viseme_{name}" for name in ("sil", "PP", "aa", "E", "I", "O", "U")]
    keys = zo.translate_key_names([*ARKIT, *visemes, "eyesLookUp"], "vrm1")
    assert keys.sources == ("arkit", "oculus")
    assert {keys.renamed[name] for name in ("viseme_aa", "viseme_O", "eyeBlinkLeft")} == {"aa", "oh", "blinkLeft"}
    assert keys.composed["lookUp"] == ("eyeLookUpLeft", "eyeLookUpRight")
    assert keys.missing == ("happy", "angry", "sad", "relaxed", "surprised", "neutral")
    assert describe(keys)[0] == "Renamed 7 shape keys from ARKit, Oculus to VRM 1."


def test_gaze_in_and_out_change_names_with_the_eye() -> None:
    renamed = zo.translate_key_names(ARKIT, "metahuman").renamed
    assert renamed["eyeLookInLeft"] == "CTRL_expressions_eyeLookRightL"
    assert renamed["eyeLookInRight"] == "CTRL_expressions_eyeLookLeftR"
    composed = zo.translate_key_names(ARKIT, "vrm1").composed
    assert composed["lookLeft"] == ("eyeLookOutLeft", "eyeLookInRight")


def test_merged_keys_are_composed_and_split_ones_left_out() -> None:
    merged = zo.translate_key_names(zo.key_names("metahuman"), "arkit")
    assert merged.composed["mouthFunnel"] == tuple(
        f"CTRL_expressions_mouthFunnel{part}" for part in ("UL", "UR", "DL", "DR")
    )
    assert merged.missing == ("mouthPressLeft", "mouthPressRight", "mouthShrugUpper")
    split = zo.translate_key_names(ARKIT, "metahuman")
    assert "mouthFunnel" not in split.renamed
    assert "CTRL_expressions_mouthFunnelUL" in split.missing


def test_parts_of_a_present_expression_are_neither_added_nor_missing() -> None:
    missing = zo.translate_key_names(ARKIT, "unified").missing
    assert "TongueUp" in missing
    assert not {"MouthCornerPullLeft", "LipFunnelUpperLeft", "BrowLowererRight"} & set(missing)
    parts = ["MouthCornerPullLeft", "MouthCornerSlantLeft", "JawOpen", "EyeClosedLeft"]
    assert zo.translate_key_names(parts, "unified").composed == {}
    assert zo.translate_key_names(parts, "arkit").composed == {"mouthSmileLeft": tuple(parts[:2])}


def test_each_name_is_given_once_and_existing_names_win() -> None:
    keys = zo.translate_key_names(["eyeBlink_L", "eyeBlinkLeft", "jaw_open", "JawOpen.001"], "arkit", "arkit")
    assert keys.renamed == {"eyeBlinkLeft": "eyeBlinkLeft", "jaw_open": "jawOpen"}
    assert zo.translate_key_names(["EyeClosedLeft", "eyeBlinkLeft"], "arkit", "unified").renamed == {
        "eyeBlinkLeft": "eyeBlinkLeft"
    }


def test_translating_back_restores_the_names() -> None:
    for convention in ("unified", "metahuman", "makehuman", "vrm0", "vrm1"):
        renamed = zo.translate_key_names(ARKIT, convention, "arkit").renamed
        back = zo.translate_key_names(list(renamed.values()), "arkit", convention).renamed
        assert {new: old for old, new in renamed.items()} == back, convention


def test_offsets_are_renamed_and_added_up() -> None:
    labels = ("jawOpen", "browInnerUp_L", "browInnerUp_R", "mine")
    values = np.random.default_rng(0).standard_normal((5, 4, 3))
    offsets = zo.Attribute("shape keys", zo.Domain.POINT, zo.Kind.OFFSET, values, labels)
    made, keys = zo.translate_offsets(offsets, "unified")
    assert made.labels == ("JawOpen", "BrowInnerUpLeft", "BrowInnerUpRight", "mine")
    np.testing.assert_array_equal(made.values, values)
    made, keys = zo.translate_offsets(offsets, "arkit")
    assert made.labels == (*labels, "browInnerUp")
    np.testing.assert_allclose(made.values[:, 4], values[:, 1] + values[:, 2])
    np.testing.assert_array_equal(made.values[:, :4], values)
    assert describe(keys) == [
        "Renamed 0 shape keys to the spelling of ARKit.",
        "Added sums of shape keys: browInnerUp = browInnerUp_L + browInnerUp_R.",
        "Missing of the 52 keys of ARKit: eyeBlinkLeft, eyeBlinkRight, eyeSquintLeft, eyeSquintRight, eyeWideLeft, "
        "eyeWideRight, eyeLookUpLeft, eyeLookUpRight, eyeLookDownLeft, eyeLookDownRight, eyeLookInLeft, "
        "eyeLookInRight, … (+38).",
    ]
    plain, keys = zo.translate_offsets(offsets, "arkit", compose=False)
    assert plain.labels == labels
    assert "browInnerUp" in describe(keys, compose=False)[-1]


@pytest.mark.parametrize("call", [zo.key_names, lambda name: zo.translate_key_names(["jawOpen"], "arkit", name)])
def test_an_unknown_convention_is_refused(call) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ValueError, match="There is no convention 'ARKit': choose from arkit, unified"):
        call("ARKit")


def test_recognised_names_are_not_parsed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    names = list(zo.key_names("arkit"))
    found = zo.recognise_key_names(names)
    monkeypatch.setattr(key_words, "_join", None)
    assert zo.recognise_key_names(names) == found


def test_the_convention_of_a_head_is_recognised_once(monkeypatch: pytest.MonkeyPatch) -> None:
    names = [f"recognisedOnce.{name}" for name in ARKIT]
    first = zo.translate_key_names(names, "vrm1")

    def fail(*_: object) -> None:
        raise AssertionError("recognised again")

    monkeypatch.setattr(key_names, "recognise_key_names", fail)
    assert zo.translate_key_names(names, "vrm1") == first
    assert zo.translate_key_names(list(names), "unified").sources == ("arkit",)
