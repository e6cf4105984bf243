# SPDX-License-Identifier: GPL-3.0-or-later
"""The page of pictures of `zoomout outfits`, in other languages."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from zoomout_core.drawing import encode_png
from zoomout_core.matching.report.verdict import AMBER, GREEN, RED
from zoomout_core.messages import message, warning
from zoomout_core.outfits.batch import OutfitsResult
from zoomout_core.outfits.dress_file import OutfitName, Worn, place_of_picture
from zoomout_core.outfits.report import page_of, write_reports
from zoomout_core.runtime.outputs import write_whole
from zoomout_core.translations import language_of, user_locale

# Latin letters that stay in a Japanese page: names of files and objects, and of HTML.
NAMES = {"Suit", "Mia", "Tom", "Ann", "Shirt", "Buckle", "dressed", "glb"}


@pytest.fixture
def result(tmp_path: Path) -> OutfitsResult:
    """Three avatars, one for each level of a verdict, and a file that failed."""
    sentences = {
        GREEN: (message("The clothes fit."), ""),
        AMBER: (
            message("{share:.1%} of the cloth is in the skin when limbs move.", share=0.02),
            message("Look at the pictures: it is marked red there."),
        ),
        RED: (
            message("The match is probably wrong: it is {certainty} certain.", certainty=message("under 1%")),
            message("Compare the other candidates, or add a few landmarks and match again."),
        ),
    }
    notes = (
        message("{count} joints of the outfit were added to the avatar.", count=12),
        warning(
            "No mesh or material of the outfit is called like '{pattern}': nothing there was kept.", pattern="Buckle"
        ),
    )
    inside, worn = {"rest": 0.0, "swing": 0.02, "spread": 0.003}, dict[OutfitName, Worn]()
    for avatar, (level, texts) in zip(("Mia", "Tom", "Ann"), sentences.items(), strict=True):
        name = OutfitName("Suit", avatar)
        write_whole(tmp_path / place_of_picture(name), encode_png(np.zeros((2, 2, 3), dtype=np.uint8)))
        worn[name] = Worn("", "dressed/Suit.glb", level, *texts, inside, 0.001, ("Shirt",), 12, notes)
    return OutfitsResult(tmp_path, worn, {"<Tom>": "No file."}, 3, 3)


def test_pages_are_in_japanese(result: OutfitsResult) -> None:
    write_reports(result, "ja")
    page = (result.folder / "report.html").read_text(encoding="utf-8")
    assert '<html lang="ja">' in page
    for text in (
        "緑1, 黄1, 赤1",
        "緑: 服は体に合っています。",
        "2.00%(前後に振る)",
        "MiaにSuit",
        "警告: 衣装に「Buckle」",
    ):
        assert text in page
    assert "<h2>失敗</h2>" in page
    body = re.sub(r"<[^>]*>", " ", page.partition("</h1>")[2].partition("<h2>失敗")[0])
    assert set(re.findall("[A-Za-z]+", body)) == NAMES


def test_pages_are_in_english_by_default(result: OutfitsResult) -> None:
    page = page_of(result)
    assert '<html lang="en">' in page
    assert "Dressed avatars: 1 green, 1 amber, 1 red." in page
    assert "Warning: No mesh or material of the outfit is called like &#x27;Buckle&#x27;" in page
    assert not re.search("[ぁ-んァ-ン一-龯]", page)


@pytest.mark.parametrize(
    ("variables", "locale", "language"),
    [
        ({"LANG": "ja_JP.UTF-8"}, "ja_JP", "ja"),
        ({"LANGUAGE": "de:ja", "LANG": "ja_JP.UTF-8"}, "de", "de"),
        ({"LC_ALL": "C.UTF-8", "LANG": "ja_JP.UTF-8"}, "C", "en"),
        ({"LANG": "fr_FR"}, "fr_FR", "en"),
        ({"LANG": ""}, "", "en"),
    ],
)
def test_the_language_is_that_of_the_system(
    variables: dict[str, str], locale: str, language: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.environ", variables)
    monkeypatch.setattr("sys.platform", "linux")
    assert (user_locale(), language_of(user_locale())) == (locale, language)
