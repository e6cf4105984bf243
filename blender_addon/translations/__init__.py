# SPDX-License-Identifier: GPL-3.0-or-later
"""The interface in other languages.

A language is a gettext .po file in this folder, named by its code. It has labels and tooltips, which Blender looks up
itself, and errors, notes, reports and stages. The add-on composes these in English, as Messages
(`zoomout_core/messages.py`), and stores them as such in the .blend file. `translated` and `reported` translate them for
display: they look up the template, and the Messages among its values. Names of objects and layers are plain text among
the values, and are not translated.

To add a language, copy `de.po`, change the code in its header, and translate each `msgstr`. It has the fields of its
`msgid`, such as `{name}` or `{share:.0%}`, in any order, and may drop the comma of `{count:,}`.
`tests/blender/test_translations.py` lists missing and
obsolete entries.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import bpy

from zoomout_core.messages import Message

from .catalogue import read_catalogue

# Context of words that Blender translates in another sense, such as "Fast" as short for "fasten".
CONTEXT = "ZoomOut"

# The translations of each language, by its code and by the English text.
LANGUAGES = {path.stem: read_catalogue(path) for path in sorted(Path(__file__).parent.glob("*.po"))}


def register() -> None:
    """Register the translations with Blender, whose own translations take precedence."""
    known = bpy.app.translations.contexts
    contexts = known.default, known.operator_default, CONTEXT
    table = {
        code: {(context, english): text for english, text in catalogue.items() for context in contexts}
        for code, catalogue in LANGUAGES.items()
    }
    bpy.app.translations.register(__package__, table)


def unregister() -> None:
    """Unregister the translations."""
    bpy.app.translations.unregister(__package__)


def translated(text: str) -> str:
    """Translate a text of the interface; unchanged if it has no translation or the user wants English."""
    return in_language(text, user_language("use_translate_interface"))


def reported(text: str) -> str:
    """Translate an operator's report, for which users may choose English separately."""
    return in_language(text, user_language("use_translate_reports"))


def in_language(text: str, locale: str) -> str:
    """Translate a text into a language by its code, with or without a country ("de", "de_DE"), if it is known."""
    code = locale if locale in LANGUAGES else locale.partition("_")[0]
    return _translation(text, LANGUAGES[code]) if code in LANGUAGES else text


def user_language(setting: str) -> str:
    """The code of Blender's language, or "" where a preference (`setting`) turns its use off."""
    view = bpy.context.preferences.view
    return bpy.app.translations.locale if getattr(view, setting, view.use_translate_interface) else ""


def _translation(text: str, catalogue: Mapping[str, str]) -> str:
    """Look up a text in a catalogue: a Message by its template and values, any other text as a whole."""
    if not isinstance(text, Message):
        return catalogue.get(text, text)
    values = {
        name: _translation(value, catalogue) if isinstance(value, Message) else value
        for name, value in text.values.items()
    }
    return catalogue.get(text.template, text.template).format(**values)
