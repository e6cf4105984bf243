# SPDX-License-Identifier: GPL-3.0-or-later
"""The interface in other languages, by the catalogues of `zoomout_core.translations`.

Blender itself looks up labels and tooltips. The add-on composes errors, notes, reports and stages in English, as
Messages, and stores them as such in the .blend file. `translated` and `reported` translate them for display.
"""

from __future__ import annotations

import bpy

from zoomout_core.translations import LANGUAGES, catalogue_of, in_language

# Context of words that Blender translates in another sense, such as "Fast" as short for "fasten".
CONTEXT = "ZoomOut"


def register() -> None:
    """Register the translations with Blender, whose own translations take precedence."""
    known = bpy.app.translations.contexts
    contexts = known.default, known.operator_default, CONTEXT
    table = {
        code: {(context, english): text for english, text in catalogue_of(code).items() for context in contexts}
        for code in LANGUAGES
    }
    bpy.app.translations.register(__name__, table)


def unregister() -> None:
    """Unregister the translations."""
    bpy.app.translations.unregister(__name__)


def translated(text: str) -> str:
    """Translate a text of the interface; unchanged if it has no translation or the user wants English."""
    return in_language(text, user_language("use_translate_interface"))


def reported(text: str) -> str:
    """Translate an operator's report, for which users may choose English separately."""
    return in_language(text, user_language("use_translate_reports"))


def user_language(setting: str) -> str:
    """The code of Blender's language, or "" where a preference (`setting`) turns its use off."""
    view = bpy.context.preferences.view
    return bpy.app.translations.locale if getattr(view, setting, view.use_translate_interface) else ""
