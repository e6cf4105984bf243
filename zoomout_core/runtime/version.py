# SPDX-License-Identifier: GPL-3.0-or-later
"""The version of this package."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def package_version() -> str:
    """The version of the installed package, a part of the keys of cached results; "sources" if it is not installed."""
    try:
        return version("zoomout-core")
    except PackageNotFoundError:  # run from its sources
        return "sources"
