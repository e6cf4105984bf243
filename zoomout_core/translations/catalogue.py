# SPDX-License-Identifier: GPL-3.0-or-later
"""Catalogues of translations: gettext's .po files, which tools such as Poedit and Weblate edit.

Blender has no `msgfmt` to compile them, so the text itself is read.
"""

from __future__ import annotations

import json
from pathlib import Path


def read_catalogue(path: Path) -> dict[str, str]:
    """The translations in a .po file, by their English text, without untranslated and fuzzy entries.

    Raises:
        ValueError: an entry is malformed, or has a context or plural forms, which are not supported.
    """
    catalogue = {}
    for entry in path.read_text(encoding="utf-8").split("\n\n"):
        lines = entry.splitlines()
        texts, keyword = {"msgid": "", "msgstr": ""}, ""
        for line in lines:
            if line.startswith("#") or not line:
                continue
            before, quote, _ = line.partition('"')
            keyword = before.strip() or keyword
            if keyword not in texts or not quote:
                raise ValueError(f"{path}: this line is not understood: {line}")
            texts[keyword] += json.loads(line.removeprefix(before))
        is_fuzzy = any(line.startswith("#,") and "fuzzy" in line for line in lines)
        if texts["msgid"] and texts["msgstr"] and not is_fuzzy:  # the header has no msgid
            catalogue[texts["msgid"]] = texts["msgstr"]
    return catalogue
