# SPDX-License-Identifier: GPL-3.0-or-later
"""A library finds the character that fits a body in any pose, mesh, unit and orientation, and refuses other bodies."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from time import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

import zoomout_core as zo
from zoomout_core.cli import main
from zoomout_core.library import asset_match as asset_match_module
from zoomout_core.library import library as library_module
from zoomout_core.library import search as search_module
from zoomout_core.library.descriptor import DESCRIPTOR, compare
from zoomout_core.library.index import key_of
from zoomout_core.library.library import INDEX
from zoomout_core.library.search import SEARCH
from zoomout_core.mesh.formats.files import write_shape
from zoomout_core.runtime.outputs import ABANDONED, OutputError
from zoomout_core.samples import creature, directions
from zoomout_core.samples.spheres import outward_hull
from zoomout_core.tuning import retune

pytestmark = pytest.mark.usefixtures("quick_search", "coarse_hulls")

# The number of the creature's tail.
TAIL = 5


def ball() -> zo.Surface:
    where = directions(600, 0)
    return zo.Surface(where, outward_hull(where))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A prepared library of a creature, one without its tail, and a broken file."""
    place = tmp_path_factory.mktemp("library")
    (place / "pack").mkdir()
    write_shape(creature(1300, seed=2).surface, place / "pack" / "whole.ply")
    write_shape(creature(1300, seed=3, without=TAIL).surface, place / "tailless.ply")
    (place / "broken.obj").write_text("v 0 0\nf 1 2 3\n")
    (place / "notes.txt").write_text("No mesh.")
    report = zo.Library(place).prepare()
    assert (report.assets, report.new) == (2, 2)
    (failure,) = report.failures.items()
    assert failure[0].name == "broken.obj"
    assert "broken.obj" in failure[1]
    return place


@pytest.fixture(scope="module")
def target() -> zo.Surface:
    """The creature in another pose, with other triangles, rotated, moved and in another unit."""
    turn = Rotation.from_euler("xyz", [40, 100, 200], degrees=True)
    surface = creature(1100, seed=1, bend=0.9).surface
    return surface.with_vertices(turn.apply(surface.vertices) * 170 + 30)


@pytest.fixture
def instant(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every file that is prepared gets the same bodies at once."""
    bodies = next(zo.Library(folder).assets()).bodies
    monkeypatch.setattr(library_module, "bodies_of", lambda surface: bodies)


def test_same_creature_ranks_first_in_any_pose_mesh_and_unit(folder: Path, target: zo.Surface) -> None:
    with retune(SEARCH, beyond=100.0):
        found = zo.Library(folder).find(target)
    assert [each.path.stem for each in found.ranked] == ["whole", "tailless"]
    assert found.best is not None
    assert found.best.certainty > 0.8
    assert "whole.ply     fit 9" in repr(found)
    assert found.ranked[0].misfit < found.ranked[1].misfit


def test_a_ball_is_refused_without_a_match(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(asset_match_module, "match", None)
    found = zo.Library(folder).find(ball())
    assert found.best is None
    assert not found.ranked
    assert found.nearest is not None
    assert f"the nearest asset is '{found.nearest.name}', but it" in found.refusal


@pytest.mark.parametrize("is_part", [False, True])
def test_a_part_without_a_certain_place_is_advised_to_choose_a_whole(
    is_part: bool, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(asset_match_module, "match", None)
    monkeypatch.setattr(search_module, "find_wholes", lambda *_: [])
    whole = ball()
    above = whole.vertices[whole.triangles][:, :, 2].min(axis=1) > 0
    bowl = zo.Surface(whole.vertices, whole.triangles[above])
    found = zo.Library(folder).find(bowl if is_part else whole)
    assert ("may be only a part, such as a bust" in found.refusal) == is_part


@pytest.mark.parametrize(
    ("certainty", "total", "refusal"),
    [
        (0.95, -20.0, ""),
        (0.95, -11.0, "deforms the target too much (fit 82%)"),
        (0.4, -20.0, "only 40% certain"),
    ],
)
def test_bad_maps_are_refused_with_the_reason(
    certainty: float, total: float, refusal: str, folder: Path, target: zo.Surface, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = SimpleNamespace(certainty=certainty, chosen=0, candidates=[SimpleNamespace(scores={"total": total})])
    monkeypatch.setattr(asset_match_module, "match", lambda *_: result)
    assets = list(zo.Library(folder).assets())
    monkeypatch.setattr(search_module, "bodies_of", lambda surface: assets[0].bodies)
    found = search_module.search(target, assets)
    assert refusal in found.refusal
    assert (found.best is None) == bool(refusal)


def test_maps_between_similar_bodies_may_deform_more() -> None:
    # A dinosaur for itself in another pose, and for an alpaca: 12 and 14 % with equal certainty.
    own, other = (zo.FoundSource("a", difference, 0.99, misfit) for difference, misfit in ((1.8, 0.12), (2.0, 0.138)))
    assert own.fits
    assert not other.fits
    assert not zo.FoundSource("a", 3.0, 0.99, 0.12).fits


def test_dissimilar_assets_are_not_matched(folder: Path, target: zo.Surface, monkeypatch: pytest.MonkeyPatch) -> None:
    result = SimpleNamespace(certainty=0.9, chosen=0, candidates=[SimpleNamespace(scores={"total": -20.0})])
    monkeypatch.setattr(asset_match_module, "match", lambda *_: result)
    assets = list(zo.Library(folder).assets())
    monkeypatch.setattr(search_module, "bodies_of", lambda surface: assets[0].bodies)
    assert [each.path for each in search_module.search(target, assets).ranked] == [assets[0].path]
    # More are matched on request.
    assert len(search_module.search(target, assets, 2).ranked) == 2
    assert len(search_module.search(target, assets, 1).ranked) == 1
    with pytest.raises(ValueError, match="compare is 0: give a whole number of 1 or more"):
        zo.find_source(target, [zo.Library(folder)], 0)


def test_assets_that_share_a_body_are_ordered_by_what_they_wear(
    folder: Path, target: zo.Surface, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = SimpleNamespace(certainty=0.9, chosen=0, candidates=[SimpleNamespace(scores={"total": -20.0})])
    monkeypatch.setattr(asset_match_module, "match", lambda *_: result)
    whole, tailless = zo.Library(folder).assets()
    monkeypatch.setattr(search_module, "bodies_of", lambda surface: whole.bodies)
    dressed = replace(whole, path=Path("dressed.ply"), bodies={**whole.bodies, "tight hull": tailless.bodies["hull"]})
    found = search_module.search(target, [dressed, whole])
    assert [each.path for each in found.ranked] == [whole.path, dressed.path]


def test_the_last_asset_to_match_is_the_nearest_by_all_bodies() -> None:
    sizes = [(1.0, 1.5), (1.1, 2.0), (1.2, 3.0), (1.3, 2.5), (1.4, 1.0)]
    rows: list[Any] = [SimpleNamespace(difference=SimpleNamespace(total=a), overall=b) for a, b in sizes]
    assert search_module._closest(rows[::-1], 4) == [*rows[:3], rows[4]]
    assert search_module._closest(rows, 1) == rows[:1]
    assert search_module._closest(rows[:2], 4) == rows[:2]


def test_an_empty_library_is_refused(target: zo.Surface) -> None:
    assert "has no assets" in search_module.search(target, []).refusal


def test_files_are_prepared_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library_module, "bodies_of", None)
    assert zo.Library(folder).prepare().new == 0
    os.utime(folder / "tailless.ply")  # the content is the same
    assert zo.Library(folder).prepare().new == 0


def refuse(_: object) -> None:
    raise OSError("It was opened.")


def test_files_of_unchanged_size_and_time_are_not_opened(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    zo.Library(folder).prepare()
    monkeypatch.setattr(library_module, "key_of", refuse)
    assert zo.Library(folder).prepare().assets == 2


def test_interrupted_preparation_resumes(
    tmp_path: Path, target: zo.Surface, instant: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("a", "b"):
        write_shape(target, tmp_path / f"{name}.ply")
        target = target.with_vertices(2 * target.vertices)
    prepare, done = library_module.bodies_of, []

    def interrupt(surface: zo.Surface) -> object:
        if done:
            raise zo.Cancelled
        done.append(surface)
        return prepare(surface)

    library = zo.Library(tmp_path, tmp_path / "index")
    monkeypatch.setattr(library_module, "bodies_of", interrupt)
    with pytest.raises(zo.Cancelled):
        library.prepare()
    monkeypatch.setattr(library_module, "bodies_of", prepare)
    assert library.prepare().new == 1
    assert len(list(library.assets())) == 2


def test_changed_files_are_prepared_again_and_removed_ones_dropped(
    tmp_path: Path, target: zo.Surface, instant: None
) -> None:
    write_shape(target, tmp_path / "a.ply")
    write_shape(ball(), tmp_path / "b.ply")
    library = zo.Library(tmp_path)
    library.prepare()
    write_shape(target.with_vertices(2 * target.vertices), tmp_path / "a.ply")
    (tmp_path / "b.ply").unlink()
    assert [asset.path.name for asset in library.assets()] == ["a.ply"]
    report = library.prepare()
    assert (report.assets, report.new) == (1, 1)
    assert len(list((tmp_path / INDEX).glob("*.npz"))) == 1


def test_damaged_index_is_rebuilt(tmp_path: Path, target: zo.Surface, instant: None) -> None:
    write_shape(target, tmp_path / "a.ply")
    library = zo.Library(tmp_path)
    library.prepare()
    (stored,) = (tmp_path / INDEX).glob("*.npz")
    stored.write_bytes(b"not arrays")
    assert not list(library.assets())
    assert library.prepare().new == 1
    listing = tmp_path / INDEX / "files.json"
    for damaged in (
        "[]",
        "{",
        listing.read_text().replace('""', '"../../a"'),
        listing.read_text().replace("a.ply", "../a.ply"),
        listing.read_text().replace(stored.stem, "../x"),
    ):
        listing.write_text(damaged)
        assert not list(library.assets())
        assert library.prepare().assets == 1
    assert len(list(library.assets())) == 1


def test_unwritable_index_is_refused_before_the_work(
    tmp_path: Path, target: zo.Surface, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_shape(target, tmp_path / "a.ply")
    monkeypatch.setattr(library_module, "bodies_of", None)
    with pytest.raises(OutputError, match=r"index .* cannot be created .*--index"):
        zo.Library(tmp_path, tmp_path / "a.ply" / "index").prepare()


@pytest.fixture
def blender(target: zo.Surface, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Names of the assets in every .blend file, with the reason why it has no surface, if any; replaces Blender."""
    names: dict[str, str] = {"": ""}

    def write_assets(path: Path, folder: Path, program: str | None) -> dict[str, Path | str]:
        assert (path.suffix, program) == (".blend", "blender-5.2")
        write_shape(target, folder / "0.ply")
        return {name: reason or folder / "0.ply" for name, reason in names.items()}

    monkeypatch.setattr(library_module, "write_assets", write_assets)
    return names


def test_blend_files_are_read_by_the_given_blender(tmp_path: Path, instant: None, blender: dict[str, str]) -> None:
    (tmp_path / "hero.blend").write_bytes(b"BLENDER")
    library = zo.Library(tmp_path, blender="blender-5.2")
    assert library.prepare().assets == 1
    assert [asset.path for asset in library.assets()] == [tmp_path / "hero.blend"]


def test_assets_of_a_blend_file_are_listed_separately(
    tmp_path: Path, instant: None, blender: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pack.blend").write_bytes(b"BLENDER")
    blender |= {"Collection/Mr. A": "", "Object/B": "", "Object/C": "It has no faces.", "Object/../D": ""}
    del blender[""]
    library = zo.Library(tmp_path, blender="blender-5.2")
    report = library.prepare()
    assert (report.assets, report.new) == (2, 2)
    pack = tmp_path / "pack.blend"
    assert report.failures == {pack / "Object/C": "It has no faces.", pack / "Object/../D": library_module.BAD_NAME}
    found = [zo.FoundSource(asset.path, 0, 1, 0) for asset in library.assets()]
    assert [each.path for each in found] == [pack / "Collection/Mr. A", pack / "Object/B"]
    assert [each.name for each in found] == ["Mr. A", "B"]
    monkeypatch.setattr(library_module, "write_assets", None)
    pack.rename(tmp_path / "renamed.blend")
    report = library.prepare()
    assert (report.assets, report.new) == (2, 0)
    assert len(list((tmp_path / INDEX).glob("*.npz"))) == 2
    (tmp_path / "renamed.blend").unlink()
    assert not list(library.assets())


def test_comparison_is_symmetric_and_grows_with_the_difference(folder: Path) -> None:
    assets = {asset.path.stem: asset.bodies["hull"].descriptor for asset in zo.Library(folder).assets()}
    whole, tailless = assets["whole"], assets["tailless"]
    np.testing.assert_allclose(compare(whole, tailless), compare(tailless, whole))
    assert compare(whole, whole).total == pytest.approx(0, abs=1e-9)
    difference = compare(whole, tailless)
    assert min(difference) > 0
    with retune(DESCRIPTOR, unpaired=0.0):
        assert compare(whole, tailless).limbs < difference.limbs
    with retune(DESCRIPTOR, spectrum=2 * DESCRIPTOR.spectrum):
        assert compare(whole, tailless).spectrum == pytest.approx(difference.spectrum / 2)


def run(*arguments: str | Path) -> tuple[int, str]:
    outcome = CliRunner().invoke(main, [str(argument) for argument in arguments])
    return outcome.exit_code, outcome.stdout


def test_commands_prepare_and_find(tmp_path: Path, folder: Path, target: zo.Surface) -> None:
    code, said = run("library", folder, "--json")
    report = json.loads(said)
    assert code == 3
    assert (report["assets"], report["new"]) == (2, 0)
    assert report["failures"][0]["file"].endswith("broken.obj")
    write_shape(target, tmp_path / "scan.ply")
    with retune(SEARCH, matched=1):
        code, said = run("find", tmp_path / "scan.ply", "--library", folder, "--json")
    found = json.loads(said)
    assert code == 0, said
    assert found["best"] == found["nearest"] == str(folder / "pack" / "whole.ply")
    assert found["refusal"] is None
    assert found["assets"][0]["fits"]
    assert "not prepared: 1;" in found["notes"][0]
    with retune(SEARCH, max_difference=0.0):
        code, said = run("find", tmp_path / "scan.ply", "--library", folder)
    assert code == 1
    assert "Nothing in the library fits" in said


def test_user_errors_are_reported(tmp_path: Path, target: zo.Surface) -> None:
    write_shape(target, tmp_path / "scan.ply")
    (tmp_path / "empty").mkdir()
    code, said = run("find", tmp_path / "scan.ply", "--library", tmp_path / "empty", "--json")
    assert code == 1
    assert "run `zoomout library` on it" in json.loads(said)["error"]
    code, said = run("library", tmp_path / "missing", "--json")
    assert code == 1
    assert "There is no folder" in json.loads(said)["error"]
    code, said = run("find", "scan.ply", "--library", "a", "--library", "b", "--index", "c", "--json")
    assert code == 2


def test_a_folder_without_meshes_is_refused_and_gets_no_index(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("No mesh.")
    ran = CliRunner().invoke(main, ["library", str(tmp_path)])
    assert ran.exit_code == 1
    assert "contain no meshes: check the path" in ran.output
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_a_changed_file_counts_as_not_prepared(tmp_path: Path, instant: None) -> None:
    for name in ("a.ply", "b.ply"):
        write_shape(ball(), tmp_path / name)
    library = zo.Library(tmp_path)
    library.prepare()
    os.utime(tmp_path / "a.ply", (1, 1))  # such as in a copy of the folder
    assert not library.new_files()
    (tmp_path / "b.ply").write_bytes(b"junk")
    assert library.new_files() == [tmp_path / "b.ply"]


@pytest.mark.parametrize("place", ["", "results"])
def test_found_sources_are_not_transferred_into_the_library(place: str, folder: Path, tmp_path: Path) -> None:
    """The next preparation would take the results for characters."""
    arguments = ["find", str(folder / "tailless.ply"), "--library", str(folder), "-o", str(folder / place)]
    for option in ("--transfer", "--move-rig"):
        ran = CliRunner().invoke(main, [*arguments, option])
        assert ran.exit_code == 1
        assert "which would take the results for its characters: choose another output folder" in ran.output


def test_preparing_twice_at_once_keeps_the_bodies_of_both(
    tmp_path: Path, instant: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first process to end does not list the files that the other is still preparing."""
    write_shape(ball(), tmp_path / "a.ply")
    bodies_of = library_module.bodies_of

    def prepare_meanwhile(surface: zo.Surface) -> Any:
        monkeypatch.setattr(library_module, "bodies_of", bodies_of)
        path = tmp_path / "b.ply"
        write_shape(surface.with_vertices(2 * surface.vertices), path)
        other._index.save(key_of([path]), bodies_of(surface))  # it is not listed yet
        return bodies_of(surface)

    library, other = zo.Library(tmp_path), zo.Library(tmp_path)
    monkeypatch.setattr(library_module, "bodies_of", prepare_meanwhile)
    library.prepare()
    assert other.prepare().new == 0
    assert [each.path.name for each in other.assets()] == ["a.ply", "b.ply"]


def test_a_file_without_bodies_counts_as_not_prepared(tmp_path: Path, instant: None) -> None:
    write_shape(ball(), tmp_path / "a.ply")
    library = zo.Library(tmp_path)
    library.prepare()
    (stored,) = (tmp_path / INDEX).glob("*.npz")
    stored.unlink()
    assert library.new_files() == [tmp_path / "a.ply"]


def test_bodies_without_a_list_are_removed_once_they_are_old(tmp_path: Path, instant: None) -> None:
    write_shape(ball(), tmp_path / "a.ply")
    library = zo.Library(tmp_path)
    library.prepare()
    left = tmp_path / INDEX / f"{'0' * 32}.npz"
    for seconds, stays in ((0, True), (ABANDONED + 60, False)):
        left.write_bytes(b"")
        os.utime(left, (time() - seconds,) * 2)
        library.prepare()
        assert left.exists() == stays
