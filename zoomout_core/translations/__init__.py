# SPDX-License-Identifier: GPL-3.0-or-later
"""Texts for the user in other languages: labels of the Blender add-on, and the sentences of all interfaces.

A language is a gettext .po file in this folder, named by its code. It has Blender's labels and tooltips, and errors,
notes, reports and stages. These are composed in English, as Messages (`zoomout_core/messages.py`), and stored as such.
`in_language` translates them for display: it looks up the template, and the Messages among its values. Names of objects
and layers are plain text among the values, and are not translated.

To add a language, copy `de.po`, change the code in its header, and translate each `msgstr`. It has the fields of its
`msgid`, such as `{name}` or `{share:.0%}`, in any order, and may drop the comma of `{count:,}`.
`tests/blender/test_translations.py` lists missing and obsolete entries.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Mapping
from functools import cache
from locale import windows_locale
from pathlib import Path

from zoomout_core.messages import Message
from zoomout_core.translations.catalogue import read_catalogue

# The language of the code, and those that it is translated into.
ENGLISH = "en"
FOLDER = Path(__file__).parent
LANGUAGES = tuple(sorted(path.stem for path in FOLDER.glob("*.po")))
# Environment variables that choose the language of messages; the first one that is set wins, as in gettext.
VARIABLES = "LANGUAGE", "LC_ALL", "LC_MESSAGES", "LANG"


@cache
def catalogue_of(language: str) -> Mapping[str, str]:
    """The translations into a language, by the English text."""
    return read_catalogue(FOLDER / f"{language}.po")


def in_language(text: str, locale: str) -> str:
    """Translate a text into the language of a locale, such as "de" or "de_DE"; unchanged if it has no translation."""
    language = language_of(locale)
    return text if language == ENGLISH else _translation(text, catalogue_of(language))


def language_of(locale: str) -> str:
    """The language of a locale, with or without a country, if texts are translated into it; otherwise English."""
    return next((code for code in (locale, locale.partition("_")[0]) if code in LANGUAGES), ENGLISH)


def user_locale() -> str:
    """The locale in which the system shows messages to the user, such as "ja_JP"; "" if it is unknown."""
    chosen = next(filter(None, map(os.environ.get, VARIABLES)), "")
    if not chosen and sys.platform == "win32":
        chosen = windows_locale.get(ctypes.windll.kernel32.GetUserDefaultUILanguage(), "")
    return chosen.partition(":")[0].partition(".")[0]


def _translation(text: str, catalogue: Mapping[str, str]) -> str:
    """Look up a text in a catalogue: a Message by its template and values, any other text as a whole."""
    if not isinstance(text, Message):
        return catalogue.get(text, text)
    values = {
        name: _translation(value, catalogue) if isinstance(value, Message) else value
        for name, value in text.values.items()
    }
    return catalogue.get(text.template, text.template).format(**values)
