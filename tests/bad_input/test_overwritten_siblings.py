# SPDX-License-Identifier: GPL-3.0-or-later
"""The materials, images and buffers beside an output replace neither an input nor a file that an input names."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from broken_gltf import DATA, content_of, document
from interfaces import assert_refused, contents, run
from naming import SECRET as PNG
from naming import with_library

import zoomout_core as zo
from meshlab_filter.commands import main as meshlab
from zoomout_core.assets.files import check_siblings, inputs_of
from zoomout_core.cli import main
from zoomout_core.runtime.outputs import OutputError


def textured(folder: Path, stem: str, library: str = "", image: str = "paint.png") -> Path:
    """Write an OBJ file with materials and an image, by any names."""
    library = library or f"{stem}.mtl"
    for name in (library, image):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
    (folder / image).write_bytes(PNG)
    path = with_library(folder, library, image)
    path = path.rename(folder / f"{stem}.obj")
    text = (folder / "a.mtl").read_text()
    (folder / "a.mtl").unlink()
    (folder / library).write_text(text.replace(image, Path(image).name) if "/" in library else text)
    return path


def edit_image(path: Path) -> None:
    """Change an image that was read already, so that writing what was read would lose the change."""
    path.write_bytes(PNG + b"edited")


@pytest.mark.parametrize(
    ("source", "output"),
    [
        ({"stem": "a", "library": "b.mtl"}, "b.obj"),
        ({"stem": "a", "image": "b_0.png"}, "b.obj"),
        ({"stem": "a"}, "a.obj"),
    ],
)
def test_obj_siblings_do_not_overwrite_inputs(source: dict[str, str], output: str, tmp_path: Path) -> None:
    path = textured(tmp_path, **source)
    asset, inputs = zo.read_asset(path), inputs_of(path)
    edit_image(tmp_path / source.get("image", "paint.png"))
    before = contents(tmp_path)
    with pytest.raises(OutputError, match="is an input, and would be overwritten: choose another output"):
        zo.write_asset(asset, tmp_path / output, inputs)
    with pytest.raises(OutputError, match="is an input, and would be overwritten"):
        check_siblings(tmp_path / output, inputs)
    assert contents(tmp_path) == before
    zo.write_asset(asset, tmp_path / "other.obj", inputs)
    check_siblings(tmp_path / "other.obj", inputs)
    assert contents(tmp_path).items() > before.items()


@pytest.mark.parametrize("how", ["hard link", "soft link", "folder"])
def test_siblings_under_another_path_do_not_overwrite_inputs(how: str, tmp_path: Path) -> None:
    path = textured(tmp_path, "a", image="b_0.png")
    out = tmp_path / "out"
    if how == "folder":
        out.symlink_to(tmp_path)
    else:
        out.mkdir()
        (out / "b_0.png").hardlink_to(tmp_path / "b_0.png")
        if how == "soft link":
            (tmp_path / "b_0.png").unlink()
            (tmp_path / "b_0.png").symlink_to(out / "b_0.png")
    asset, inputs = zo.read_asset(path), inputs_of(path)
    edit_image(tmp_path / "b_0.png")
    before = contents(tmp_path)
    with pytest.raises(OutputError, match="would be overwritten"):
        zo.write_asset(asset, out / "b.obj", inputs)
    assert contents(tmp_path) == before


@pytest.mark.parametrize(("buffer", "image"), [("b.bin", "paint.png"), ("data.bin", "b_0.png")])
def test_gltf_siblings_do_not_overwrite_inputs(buffer: str, image: str, tmp_path: Path) -> None:
    tree = document()
    tree["buffers"][0]["uri"], tree["images"], tree["textures"] = buffer, [{"uri": image}], [{"source": 0}]
    tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    (tmp_path / "a.gltf").write_bytes(content_of(tree))
    (tmp_path / buffer).write_bytes(DATA)
    (tmp_path / image).write_bytes(PNG)
    asset = zo.read_asset(tmp_path / "a.gltf")
    edit_image(tmp_path / image)
    before = contents(tmp_path)
    with pytest.raises(OutputError, match="would be overwritten"):
        zo.write_asset(asset, tmp_path / "b.gltf", inputs_of(tmp_path / "a.gltf"))
    with pytest.raises(OutputError, match="would be overwritten"):
        check_siblings(tmp_path / "b.gltf", inputs_of(tmp_path / "a.gltf"))
    assert contents(tmp_path) == before
    zo.write_asset(asset, tmp_path / "c.gltf", inputs_of(tmp_path / "a.gltf"))
    assert {"c.gltf", "c.bin", "c_0.png"} == contents(tmp_path).keys() - before.keys()
    written = json.loads((tmp_path / "c.gltf").read_text())
    assert [each["uri"] for each in (*written["buffers"], *written["images"])] == ["c.bin", "c_0.png"]
    again = zo.read_asset(tmp_path / "c.gltf")
    assert again.materials == asset.materials
    assert again.surface.vertices.tolist() == asset.surface.vertices.tolist()


def test_unchanged_input_is_not_rewritten(tmp_path: Path) -> None:
    path = textured(tmp_path, "a", image="b_0.png")
    os.utime(tmp_path / "b_0.png", (1, 1))
    zo.write_asset(zo.read_asset(path), tmp_path / "b.obj", inputs_of(path))
    assert (tmp_path / "b_0.png").stat().st_mtime == 1
    assert zo.read_asset(tmp_path / "b.obj").materials[0].image == PNG


@pytest.mark.parametrize("names", [{"library": "out/target.mtl"}, {"image": "out/target_0.png"}])
def test_command_keeps_files_named_by_its_inputs(
    names: dict[str, str], meshes: tuple[Path, Path], tmp_path: Path
) -> None:
    path = textured(tmp_path, "source", **names)
    before = contents(tmp_path)
    ran = run(main, "transfer", path, meshes[1], "-o", tmp_path / "out" / "target.obj", "--kinds", "materials")
    assert_refused(ran, "is an input, and would be overwritten: choose another output, or pass --in-place")
    assert contents(tmp_path) == before


def test_map_does_not_overwrite_buffer_of_an_input(meshes: tuple[Path, Path], tmp_path: Path) -> None:
    tree = document()
    tree["buffers"][0]["uri"] = "map.npz"
    (tmp_path / "a.gltf").write_bytes(content_of(tree))
    (tmp_path / "map.npz").write_bytes(DATA)
    ran = run(main, "match", tmp_path / "a.gltf", meshes[1], "-o", tmp_path / "map.npz")
    assert_refused(ran, "map.npz is an input, and would be overwritten")
    assert (tmp_path / "map.npz").read_bytes() == DATA


# --- files that are inputs in another way: named by an option, or by an input, and in a place for results -------

OVERWRITING = {
    "pairs as the output": ("p.glb", "transfer source.ply target.ply -o p.glb --landmarks p.glb"),
    "pairs as materials": ("o.mtl", "transfer source.ply target.ply -o o.obj --landmarks o.mtl"),
    "pairs as the report": ("out/report.json", "transfer source.ply target.ply -o out --landmarks out/report.json"),
    "a map as the output": ("m.glb", "transfer source.ply target.ply -o m.glb --initial m.glb"),
    "a map as the report": ("out/report.json", "transfer source.ply target.ply -o out --initial out/report.json"),
    "an earlier map as a buffer": ("o.bin", "transfer source.ply target.ply -o o.gltf --earlier-map o.bin"),
    "a buffer as the report": ("out/report.json", "transfer named.gltf target.ply -o out"),
    "landmarks as pairs": ("o.csv", "landmarks source.ply l.csv target.ply -o o.csv --landmarks o.csv"),
    "landmarks as a map": ("o.csv", "landmarks source.ply l.csv target.ply -o o.csv --initial o.csv"),
    "landmarks as a template's buffer": ("o.csv", "landmarks named.gltf l.csv target.ply -o o.csv"),
    "landmarks as a target's buffer": ("o.csv", "landmarks source.ply l.csv named.gltf -o o.csv"),
    "a report as a template's buffer": ("out/report.json", "landmarks named.gltf l.csv target.ply -o out"),
    "pairs as a collection's report": ("out/report.json", "collection . -o out --pairs out/report.json"),
    "pairs as a collection's page": ("out/report.html", "collection . -o out --pairs out/report.html"),
    "a buffer as a collection's report": ("out/report.json", "collection . -o out"),
    "a buffer as a collection's mesh": ("out/meshes/a.glb", "collection . -o out --template named.gltf --transfer"),
    "a buffer as a collection's surface": ("out/surfaces/a.ply", "collection . -o out --restart"),
    "a buffer in a collection's cache": ("out/cache/a.bin", "collection . -o out"),
}


@pytest.mark.parametrize("name", OVERWRITING)
def test_files_named_by_options_or_inputs_are_inputs(
    name: str, meshes: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept, command = OVERWRITING[name]
    (tmp_path / kept).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / kept).write_bytes(DATA)
    (tmp_path / "l.csv").write_text("1\n2\n")
    tree = document()
    tree["buffers"][0]["uri"] = kept
    (tmp_path / "named.gltf").write_bytes(content_of(tree))
    monkeypatch.chdir(tmp_path)
    before = contents(tmp_path)
    assert_refused(run(main, *command.split()), f"{kept} is an input")
    assert contents(tmp_path) == before


@pytest.mark.parametrize("option", ["--landmarks", "--initial"])
def test_meshlab_keeps_files_named_by_options(option: str, meshes: tuple[Path, Path], tmp_path: Path) -> None:
    pytest.importorskip("pymeshlab")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.json").write_text("1 1\n")
    arguments = ("transfer", *meshes, "-o", tmp_path / "out", option, tmp_path / "out" / "report.json")
    assert_refused(run(meshlab, *arguments), "report.json is an input, and would be overwritten")
    assert (tmp_path / "out" / "report.json").read_text() == "1 1\n"


def test_a_collection_removes_only_its_own_files(meshes: tuple[Path, Path], tmp_path: Path) -> None:
    others = "shapes/mine.npz", "maps/mine/source.npz", "surfaces/source-1.ply", "carried/mine.json", "cache/mine.npz"
    out = tmp_path / "out"
    for name in others:
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_bytes(DATA)
    arguments = ("collection", *meshes, "-o", out, "--workers", "1", "--detail", "fast", "--no-pictures")
    ran = run(main, *arguments, "--restart")
    assert ran.exit_code == 0, ran.output
    found = contents(out)
    assert [name for name in others if found.get(name) != DATA] == []
    assert [name for name in found if name.startswith("cache/")] == ["cache/mine.npz"]
    made = out / "maps" / "source" / "target.npz"
    made = made if made.exists() else out / "maps" / "target" / "source.npz"
    made.write_bytes(DATA)
    assert run(main, *arguments, "--restart").exit_code == 0
    assert made.read_bytes() != DATA
