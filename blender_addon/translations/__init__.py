"""What the interface says in other languages: a module each, whose `MESSAGES` has the text for what it says in English.

To add a language copy a module, translate the values, and name it in `LANGUAGES` by its code. What is composed of
several parts, such as a report, stays English.
"""

from __future__ import annotations

import bpy

from . import german

# Of what Blender has words for that mean something else, as of a "Fast" that is short for "fasten".
CONTEXT = "ZoomOut"
LANGUAGES = {"de": german.MESSAGES}


def register() -> None:
    """Register them with Blender; its own translations of its own words take precedence."""
    known = bpy.app.translations.contexts
    contexts = known.default, known.operator_default, CONTEXT
    table = {
        code: {(context, message): text for message, text in messages.items() for context in contexts}
        for code, messages in LANGUAGES.items()
    }
    bpy.app.translations.register(__package__, table)


def unregister() -> None:
    """Take them away again."""
    bpy.app.translations.unregister(__package__)
