# SPDX-License-Identifier: GPL-3.0-or-later
"""Output on a terminal, into a file or a pipe, in whatever encoding it has."""

from __future__ import annotations

import os
import sys


def print_any_character() -> None:
    """Have characters that the standard output cannot show, as in a terminal of Windows, printed as numbers."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # not if a program has replaced it
            stream.reconfigure(errors="backslashreplace")


def drop_output() -> None:
    """Print nothing more on the standard output, where writing has failed; Python would try again when it ends."""
    with open(os.devnull, "w") as nothing:
        os.dup2(nothing.fileno(), sys.stdout.fileno())
