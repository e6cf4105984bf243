# SPDX-License-Identifier: GPL-3.0-or-later
"""The interface in other languages.

A language is a .po file of gettext in this folder, named by its code. It has labels and tooltips, which Blender looks
up by itself, and errors, notes, reports and stages. These are composed in English while the add-on works, as Messages
(`zoomout_core/messages.py`), and are stored as such in the .blend file. `translated` and `reported` give them in the
user's language where they are shown: a template is looked up, and so are the Messages among its values. Names of
objects and layers are plain text among the values, and stay as they are.

To add a language, copy `de.po`, change the code in its header, and translate each `msgstr`. It has the fields of its
`msgid`, such as `{name}` or `{share:.0%}`, in any order. `tests/blender/test_translations.py` lists what is missing,
and what is no longer in the code.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import bpy

from zoomout_core.messages import Message

from .catalogue import read_catalogue

# Of what Blender has words for that mean something else, as of a "Fast" that is short for "fasten".
CONTEXT = "ZoomOut"

# The translations of each language by its code, by their English text.
LANGUAGES = {path.stem: read_catalogue(path) for path in sorted(Path(__file__).parent.glob("*.po"))}


def register() -> None:
    """Register them with Blender; its own translations of its own words take precedence."""
    known = bpy.app.translations.contexts
    contexts = known.default, known.operator_default, CONTEXT
    table = {
        code: {(context, english): text for english, text in catalogue.items() for context in contexts}
        for code, catalogue in LANGUAGES.items()
    }
    bpy.app.translations.register(__package__, table)


def unregister() -> None:
    """Take them away again."""
    bpy.app.translations.unregister(__package__)


def translated(text: str) -> str:
    """A text of the interface in the user's language, or as it is where that has none, or the user wants English."""
    return in_language(text, user_language("use_translate_interface"))


def reported(text: str) -> str:
    """The same of what an operator reports, which the user may have in English for itself."""
    return in_language(text, user_language("use_translate_reports"))


def in_language(text: str, locale: str) -> str:
    """A text in a language by its code, with or without a country ("de", "de_DE"), or as it is in another one."""
    code = locale if locale in LANGUAGES else locale.partition("_")[0]
    return _translation(text, LANGUAGES[code]) if code in LANGUAGES else text


def user_language(setting: str) -> str:
    """The language that Blender shows, or nothing where a setting of the user's says that it is not to be used."""
    view = bpy.context.preferences.view
    return bpy.app.translations.locale if getattr(view, setting, view.use_translate_interface) else ""


def _translation(text: str, catalogue: Mapping[str, str]) -> str:
    """A text by the catalogue of a language: a Message by its template and values, another text as a whole."""
    if not isinstance(text, Message):
        return catalogue.get(text, text)
    values = {
        name: _translation(value, catalogue) if isinstance(value, Message) else value
        for name, value in text.values.items()
    }
    return catalogue.get(text.template, text.template).format(**values)
