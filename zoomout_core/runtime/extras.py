# SPDX-License-Identifier: GPL-3.0-or-later
"""How to install the packages of an extra."""

from __future__ import annotations


def install_hint(extra: str) -> str:
    """The command that installs the packages of an extra. The project is not on a package index yet."""
    return f"in the checkout, pip install '.[{extra}]'"
