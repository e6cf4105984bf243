# SPDX-License-Identifier: GPL-3.0-or-later
"""The version of this package."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def package_version() -> str:
    """That of the installed package, which what is stored depends on."""
    try:
        return version("zoomout-core")
    except PackageNotFoundError:  # run from its sources
        return "sources"
