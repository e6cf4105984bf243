# SPDX-License-Identifier: GPL-3.0-or-later
"""Released files link to the project's address, if one is given."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import release

URL = "https://example.org/project"


def test_links_of_the_readme_become_absolute_and_others_stay() -> None:
    text = "[a](docs/a.md) ![b](docs/b.png) [c](https://c.org) [d](#d) `[e][f]` (docs/g.md)"
    assert release.with_absolute_links(text, URL, "1.2") == (
        f"[a]({URL}/blob/v1.2/docs/a.md) ![b]({URL}/raw/v1.2/docs/b.png) [c](https://c.org) [d](#d) `[e][f]` "
        "(docs/g.md)"
    )
    readme = release.with_absolute_links((release.ROOT / "README.md").read_text(encoding="utf-8"), URL, "1.2")
    targets = [target for _, _, target in release.LINK.findall(readme)]
    assert len(targets) > 5
    assert all(map(release.is_absolute, targets))


def test_metadata_gets_the_address_and_keeps_other_fields() -> None:
    before = (release.ROOT / "pyproject.toml").read_text(encoding="utf-8")
    project = tomllib.loads(release.with_addresses(before, URL))["project"]
    assert project.pop("urls")["Homepage"] == URL
    assert project == tomllib.loads(before)["project"]


def test_source_distribution_includes_existing_folders() -> None:
    lines = (release.ROOT / "MANIFEST.in").read_text(encoding="utf-8").splitlines()
    grafted = {line.split()[1] for line in lines if line.startswith("graft ")}
    assert grafted == {"benchmarks", "blender_addon", "docs", "tests", "tools"}
    assert all(Path(release.ROOT / name).is_dir() for name in grafted)


def test_all_files_state_the_same_version() -> None:
    def stated(name: str, pattern: str) -> str:
        return re.findall(pattern, (release.ROOT / name).read_text(encoding="utf-8"), re.MULTILINE)[0]

    version = stated("pyproject.toml", r'^version = "(.+)"$')
    assert stated("blender_addon/blender_manifest.toml", r'^version = "(.+)"$') == version
    assert stated("CITATION.cff", r"^version: (.+)$") == version
    assert stated("CHANGELOG.md", r"^## (\d.*)$") == version  # below "Unreleased"
