# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension is tested in the chosen versions of Blender, whose environments can be set up beforehand."""

from __future__ import annotations

from pathlib import Path

import blender_versions
import pytest


@pytest.mark.parametrize(("arguments", "tested"), [(["--ends"], True), (["--ends", "--prepare"], False)])
def test_environments_can_be_set_up_without_testing(
    arguments: list[str], tested: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    ends = list(blender_versions.VERSIONS)[:: len(blender_versions.VERSIONS) - 1]
    set_up: list[str] = []
    passed: list[str] = []
    monkeypatch.setattr(blender_versions, "has_python", lambda name: True)
    monkeypatch.setattr(blender_versions, "environment", lambda name: set_up.append(name))
    monkeypatch.setattr(blender_versions, "passes", lambda name, archive: passed.append(name) or True)
    monkeypatch.setattr(blender_versions.extension, "build", lambda platforms: [Path("extension.zip")])
    monkeypatch.setattr("sys.argv", ["blender_versions.py", *arguments])
    blender_versions.main()
    assert (set_up, passed) == (([], ends) if tested else (ends, []))
