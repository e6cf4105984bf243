# SPDX-License-Identifier: GPL-3.0-or-later
"""Output to a terminal, a file or a pipe, in any encoding."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable

# Characters that move the cursor, act on a terminal or turn the direction of text; names of files may contain them.
ACTING = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def print_any_character() -> None:
    """Print characters as numbers if the standard output cannot show them, such as on Windows, or would obey them.

    A standard error that is closed discards all text.
    """
    if sys.stderr is None:  # the user has closed it; the next opened file must not take its place
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115, until the process ends
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # not if a program has replaced it
            stream.reconfigure(errors="backslashreplace")
            setattr(stream, "write", _harmless(stream.write))  # noqa: B010, which mypy wants


def _harmless(write: Callable[[str], int]) -> Callable[[str], int]:
    return lambda text: write(ACTING.sub(lambda each: each[0].encode("unicode_escape").decode(), text))


def drop_output() -> None:
    """Print nothing more on the standard output, where writing has failed; Python would try again when it ends."""
    with open(os.devnull, "w") as nothing:
        os.dup2(nothing.fileno(), sys.stdout.fileno())
