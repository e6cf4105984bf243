# SPDX-License-Identifier: GPL-3.0-or-later
"""What the interface says in other languages.

A language has two modules. `MESSAGES` of the one has the text of each label and tooltip, which Blender looks up by
itself. `SENTENCES` of the other has errors, notes, reports, stages and whatever else is composed while the add-on
works: `{}` stands for each value, see `templates`. These are made in English, and kept so in the .blend file;
`translated` and `reported` give them in the user's language where they are shown, before they are broken into lines.

To add a language copy `german.py` and `german_sentences.py`, translate the values, and name both tables in `LANGUAGES`
by the language's code. Nouns that are put into sentences are entries as well ("shape keys"), so that they can be
declined; where a sentence needs another article for each of some words, it may be given once for each ("… of the
source …", "… of the target …"). `tests/blender/test_translations.py` and `test_sentences.py` name what is missing, and
what no longer stands in the code.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import NamedTuple

import bpy

from . import german, german_sentences
from .templates import Translator

# Of what Blender has words for that mean something else, as of a "Fast" that is short for "fasten".
CONTEXT = "ZoomOut"
# How many texts are kept translated: more than all panels show at a time.
KEPT = 1024


class Language(NamedTuple):
    """The tables of a language."""

    messages: Mapping[str, str]
    sentences: Mapping[str, str]


LANGUAGES = {"de": Language(german.MESSAGES, german_sentences.SENTENCES)}


def register() -> None:
    """Register them with Blender; its own translations of its own words take precedence."""
    known = bpy.app.translations.contexts
    contexts = known.default, known.operator_default, CONTEXT
    table = {
        code: {(context, message): text for message, text in language.messages.items() for context in contexts}
        for code, language in LANGUAGES.items()
    }
    bpy.app.translations.register(__package__, table)


def unregister() -> None:
    """Take them away again."""
    bpy.app.translations.unregister(__package__)
    _translator.cache_clear()
    _in_language.cache_clear()


def translated(text: str) -> str:
    """A text of the interface in the user's language, or as it is where that has none, or the user wants English."""
    return in_language(text, user_language("use_translate_interface"))


def reported(text: str) -> str:
    """The same of what an operator reports, which the user may have in English for itself."""
    return in_language(text, user_language("use_translate_reports"))


def in_language(text: str, locale: str) -> str:
    """A text in a language by its code, with or without a country ("de", "de_DE"), or as it is in another one."""
    code = locale if locale in LANGUAGES else locale.partition("_")[0]
    return _in_language(text, code) if text and code in LANGUAGES else text


def user_language(setting: str) -> str:
    """The language that Blender shows, or nothing where a setting of the user's says that it is not to be used."""
    view = bpy.context.preferences.view
    return bpy.app.translations.locale if getattr(view, setting, view.use_translate_interface) else ""


@lru_cache(maxsize=KEPT)
def _in_language(text: str, code: str) -> str:
    return _translator(code)(text)


@lru_cache
def _translator(code: str) -> Translator:
    return Translator(*LANGUAGES[code])
