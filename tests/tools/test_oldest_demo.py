# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo in the oldest Blender: its version and its wheels, without running it, which takes minutes."""

import tomllib
import zipfile

import extension
import oldest_demo


def test_demo_uses_oldest_blender_of_the_manifest():
    manifest = tomllib.loads((extension.ADDON / extension.MANIFEST).read_text())
    assert oldest_demo.OLDEST.split(".")[:2] == manifest["blender_version_min"].split(".")[:2]


def test_demo_installs_only_wheels_of_the_zip(tmp_path, monkeypatch):
    wheel = tmp_path / "one.whl"
    with zipfile.ZipFile(wheel, "w") as written:
        written.writestr("one/__init__.py", "")
    asked = []
    monkeypatch.setattr(extension, "locked_wheels", lambda *of: asked.append(of) or [wheel])
    monkeypatch.setattr(oldest_demo, "LIBRARIES", tmp_path / "libraries")
    (tmp_path / "libraries" / "former").mkdir(parents=True)
    oldest_demo.unpack("3.11")
    assert [path.name for path in (tmp_path / "libraries").iterdir()] == ["one"]
    assert asked == [("cp311", extension.this_platform())]
