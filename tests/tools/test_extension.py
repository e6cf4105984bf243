# SPDX-License-Identifier: GPL-3.0-or-later
"""The content of the extension's zips, and its reproducibility."""

import re
import sys
import tomllib
import zipfile

import extension
import pytest
from packaging.requirements import Requirement

PROJECT = tomllib.loads((extension.ROOT / "pyproject.toml").read_text())["project"]


@pytest.mark.parametrize("python", extension.PYTHONS)
def test_pinned_wheels_satisfy_core_dependencies_except_numpy(python):
    required = {one.name: one.specifier for one in map(Requirement, PROJECT["dependencies"])}
    pinned = dict(pin.split("==") for pin in extension.requirements(extension.LOCKS / f"{python}.txt"))
    assert set(pinned) == set(required) - {"numpy"}
    assert all(required[name].contains(version) for name, version in pinned.items())


def test_every_pin_has_a_hash():
    for lock in extension.LOCKS.glob("*.txt"):
        requirements = re.split(r"(?<!\\)\n", lock.read_text())
        pins = [text for text in requirements if text and not text.startswith("#")]
        assert pins
        assert all(re.match(r"[\w.-]+==[\w.]+ \\\n    --hash=sha256:", text) for text in pins)


def test_pure_python_wheel_has_one_pinned_version():
    """Blender installs all compatible wheels, so with two versions of one it could use either."""
    any_python = [
        next(
            pin for pin in extension.requirements(extension.LOCKS / f"{python}.txt") if pin.startswith("threadpoolctl")
        )
        for python in extension.PYTHONS
    ]
    assert len(set(any_python)) == 1


def test_platform_and_wheels_go_before_the_first_table_of_the_manifest():
    manifest = (extension.ADDON / extension.MANIFEST).read_text()
    fields = tomllib.loads(extension.completed_manifest(manifest, "linux-x64", ["a.whl", "b.whl"]))
    added = {"platforms": ["linux-x64"], "wheels": ["./wheels/a.whl", "./wheels/b.whl"]}
    assert fields == tomllib.loads(manifest) | added


def test_zip_contains_license_but_not_demo():
    files = set(extension.shipped_files())
    assert {"__init__.py", "operators/matching/match.py", "LICENSE"} <= files
    assert not any(name.startswith("demo/") for name in files)


def test_zip_documentation_has_no_broken_links_or_pictures(tmp_path):
    pages = extension.built_pages(tmp_path)
    assert {"docs/blender.html", "docs/transfer.html"} <= pages.keys()
    for name, page in pages.items():
        if name.endswith(".html"):
            for place, section in re.findall(r'(?:src|href)="([^"#]*)#?([^"]*)"', page.decode()):
                there = f"docs/{place}" if place else name
                assert there in pages, place
                assert not section or f'id="{section}"'.encode() in pages[there], section


def test_whats_new_starts_with_current_version():
    assert (
        re.findall(r"^## (.+)$", (extension.DOCS / "whats_new.md").read_text(), re.MULTILINE)[0] == PROJECT["version"]
    )


def test_extension_page_uses_only_existing_or_generated_pictures():
    named = re.findall(
        r"\b(docs/images|images|dist/page)/(\w+\.\w+)", (extension.DOCS / "extension_page.md").read_text()
    )
    assert {name for folder, name in named if folder == "dist/page"} == {"icon.png", "featured.jpg", "animation.mp4"}
    assert all((extension.DOCS / "images" / name).exists() for folder, name in named if folder != "dist/page")


def test_a_file_that_no_pattern_names_is_refused(tmp_path, monkeypatch):
    (tmp_path / "__init__.py").touch()
    (tmp_path / "notes.txt").touch()
    monkeypatch.setattr(extension, "ADDON", tmp_path)
    monkeypatch.setattr(extension, "ROOT", tmp_path)
    with pytest.raises(ValueError, match=r"notes\.txt"):
        extension.shipped_files()


def test_versions_that_differ_are_refused():
    with pytest.raises(ValueError, match="version 99"):
        extension.check_version("99")
    extension.check_version(PROJECT["version"])


def test_archive_depends_only_on_names_and_content(tmp_path):
    content = {"b.py": b"b", "a.py": b"a", "wheels/c.whl": b"c"}
    extension.write_archive(tmp_path / "one.zip", content)
    extension.write_archive(tmp_path / "two.zip", dict(sorted(content.items())))
    assert (tmp_path / "one.zip").read_bytes() == (tmp_path / "two.zip").read_bytes()


@pytest.mark.parametrize(
    ("system", "processor", "name"),
    [
        ("linux", "x86_64", "linux-x64"),
        ("darwin", "arm64", "macos-arm64"),
        ("darwin", "x86_64", "macos-x64"),
        ("win32", "AMD64", "windows-x64"),
        ("win32", "ARM64", "windows-arm64"),
    ],
)
def test_the_zip_for_this_machine_is_built_by_default(monkeypatch, system, processor, name):
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(extension.machine, "machine", lambda: processor)
    monkeypatch.setattr(sys, "argv", ["extension.py"])
    built = []
    monkeypatch.setattr(extension, "build", lambda platforms: built.extend(platforms) or [])
    assert name in extension.PLATFORMS or name in extension.UNSUPPORTED
    if name in extension.UNSUPPORTED:
        with pytest.raises(SystemExit, match="There is no zip for windows-arm64"):
            extension.main()
    else:
        extension.main()
        assert built == [name]


def test_all_option_builds_every_zip(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["extension.py", "--all"])
    built = []
    monkeypatch.setattr(extension, "build", lambda platforms: built.extend(platforms) or [])
    extension.main()
    assert built == list(extension.PLATFORMS)


@pytest.mark.slow
def test_core_wheel_is_reproducible_and_contains_only_the_core(tmp_path):
    one, two = (extension.build_core_wheel(tmp_path / name) for name in ("one", "two"))
    assert one.name == two.name == f"zoomout_core-{PROJECT['version']}-py3-none-any.whl"
    assert one.read_bytes() == two.read_bytes()
    with zipfile.ZipFile(one) as wheel:
        folders = {name.split("/")[0] for name in wheel.namelist()}
    assert folders == {"zoomout_core", f"zoomout_core-{PROJECT['version']}.dist-info"}
