# SPDX-License-Identifier: GPL-3.0-or-later
"""Arguments of wrong types are refused with a message, and missing dependencies of a file format are named."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import pytest
from creatures import creature
from interfaces import assert_refused, run
from scipy.sparse import csr_array

import zoomout_core as zo
from zoomout_core.cli import main
from zoomout_core.matching.constraints import check_axes
from zoomout_core.mesh.errors import MeshError
from zoomout_core.runtime.outputs import OutputError
from zoomout_core.transfer import Blend

SURFACE = creature(100).surface
SAME = zo.SurfaceMap(np.zeros(100, dtype=int), np.tile([1.0, 0, 0], (100, 1)), SURFACE.triangles)
NUMBERS = zo.Attribute("numbers", zo.Domain.POINT, zo.Kind.SCALAR, np.zeros(100))

BASIS = zo.eigenbasis(SURFACE, 20)


def attribute(domain: Any = zo.Domain.POINT, kind: Any = zo.Kind.SCALAR) -> zo.Attribute:
    """An attribute of the surface."""
    return zo.Attribute("it", domain, kind, np.zeros(100))


def moved(values: Any, kind: zo.Kind) -> zo.Attribute:
    """Values at the surface's vertices, transferred."""
    return zo.transfer(zo.Attribute("it", zo.Domain.POINT, kind, values), SAME, SURFACE, SURFACE)


WRONG: dict[str, Callable[[], object]] = {
    "a number as a shape": lambda: zo.match(3, SURFACE),  # type: ignore[arg-type]
    "nothing as a shape": lambda: zo.match(SURFACE, None),  # type: ignore[arg-type]
    "a dictionary as a shape": lambda: zo.detect_symmetry({}),  # type: ignore[arg-type]
    "a shape of one array": lambda: zo.eigenbasis(np.zeros((5, 3))),  # type: ignore[arg-type]
    "options of a dictionary": lambda: zo.match(SURFACE, SURFACE, {"k_final": 9}),  # type: ignore[arg-type]
    "a size in words": lambda: zo.match(SURFACE, SURFACE, k_final="large"),
    "a size with a fraction": lambda: zo.match(SURFACE, SURFACE, k_final=20.5),
    "no step": lambda: zo.match(SURFACE, SURFACE, step=None),
    "a seed in words": lambda: zo.match(SURFACE, SURFACE, seed="one"),
    "landmarks of a number": lambda: zo.match(SURFACE, SURFACE, landmarks=3),
    "landmarks in words": lambda: zo.match(SURFACE, SURFACE, landmarks=(["nose"], ["nose"])),
    "landmarks of three lists": lambda: zo.match(SURFACE, SURFACE, landmarks=([1], [2], [3])),
    "regions of a number": lambda: zo.match(SURFACE, SURFACE, regions=3),
    "an axis in words": lambda: zo.match(SURFACE, SURFACE, common_axes="up"),
    "an axis of two numbers": lambda: zo.match(SURFACE, SURFACE, common_axes=(0, 1)),
    "a start of a number": lambda: zo.match(SURFACE, SURFACE, initial=3),
    "an initial map in words": lambda: zo.match(SURFACE, SURFACE, initial="given", initial_map="map"),
    "numbers as bases": lambda: zo.zoomout(1, 2, [0]),  # type: ignore[arg-type]
    "eigenfunctions in words": lambda: zo.eigenbasis(SURFACE, k="all"),  # type: ignore[arg-type]
    "a number as a match": lambda: zo.transfer(NUMBERS, 3, SURFACE, SURFACE),  # type: ignore[arg-type]
    "an array as an attribute": lambda: zo.transfer(np.zeros(100), SAME, SURFACE, SURFACE),  # type: ignore[arg-type]
    "a number as what is wrapped": lambda: zo.wrap(SAME, 3, SURFACE),  # type: ignore[arg-type]
    "a number as a match to wrap by": lambda: zo.wrap(3, SURFACE, SURFACE),  # type: ignore[arg-type]
    "a number as a match to conform by": lambda: zo.conform(3, SURFACE, SURFACE),  # type: ignore[arg-type]
    "a number as a path": lambda: zo.read_surface(3),  # type: ignore[arg-type]
    "a number near a shape": lambda: zo.match_by_proximity(3, SURFACE),  # type: ignore[arg-type]
    "a distance in words": lambda: zo.match_by_proximity(SURFACE, SURFACE, max_distance="near"),  # type: ignore[arg-type]
    "values in words": lambda: SAME.interpolate("values"),  # type: ignore[arg-type]
    "too few values": lambda: SAME.interpolate(np.zeros(3)),
    "vertices in words": lambda: zo.Surface("vertices", [[0, 1, 2]]),
    "faces that are none": lambda: zo.Surface(SURFACE.vertices, None),  # type: ignore[arg-type]
    "points in words": lambda: zo.PointCloud("points"),
    "a surface as a basis": lambda: zo.wave_kernel_signature(SURFACE),  # type: ignore[arg-type]
    "a seed below zero": lambda: zo.match(SURFACE, SURFACE, seed=-1),
    "symmetries by a letter": lambda: zo.detect_symmetry(SURFACE, max_count="a"),  # type: ignore[arg-type]
    "half a symmetry": lambda: zo.detect_symmetry(SURFACE, max_count=0.5),  # type: ignore[arg-type]
    "no number of symmetries": lambda: zo.detect_symmetry(SURFACE, max_count=None),  # type: ignore[arg-type]
    "true symmetries": lambda: zo.detect_symmetry(SURFACE, max_count=True),
    "a symmetry's seed in words": lambda: zo.detect_symmetry(SURFACE, seed="one"),  # type: ignore[arg-type]
    "a left side in words": lambda: zo.detect_symmetry(SURFACE, left="up"),
    "a left side of nothing": lambda: zo.detect_symmetry(SURFACE, left=[{}, {}, {}]),  # type: ignore[arg-type]
    "faces of one column of three rows": lambda: zo.Surface(np.eye(3), np.arange(3).reshape(1, 3, 1)),
    "faces of faces": lambda: zo.Surface(np.eye(3), np.arange(3).reshape(1, 1, 3)),
    "faces of lists": lambda: zo.Surface(np.eye(3), [[[0], [1], [2]]]),  # type: ignore[arg-type]
    "a face with a list in it": lambda: zo.Surface(np.eye(3), [[0, [1], 2]]),  # type: ignore[arg-type]
    "faces of words": lambda: zo.Surface(np.eye(3), [["a", "b", "c"]]),  # type: ignore[arg-type]
    "faces of objects": lambda: zo.Surface(np.eye(3), np.array([[0, 1, 2]], dtype=object)),
    "a face of numbers in a row": lambda: zo.Surface(np.eye(3), np.arange(3)),
    "a kind in words": lambda: attribute(kind="scalar"),
    "no kind": lambda: attribute(kind=None),
    "a domain in words": lambda: attribute(domain="point"),
    "a domain of a number": lambda: attribute(domain=1),
    "a kind as the domain": lambda: attribute(domain=zo.Kind.UV),
    "labels of nothing": lambda: moved(np.array([None] * 100), zo.Kind.LABEL),
    "labels of text and numbers": lambda: moved(np.array(["a", 1] * 50, dtype=object), zo.Kind.LABEL),
    "rotations far too large": lambda: moved(np.full((100, 4), 1e308), zo.Kind.QUATERNION),
    "matrices far too large": lambda: moved(np.full((100, 16), 1e308), zo.Kind.MATRIX),
    "weights far too large": lambda: moved(csr_array(np.full((100, 2), 1e308)), zo.Kind.WEIGHT),
    "an option that a kind lacks": lambda: zo.transfer(NUMBERS, SAME, SURFACE, SURFACE, smooth=3),
    "confidence in words": lambda: zo.transfer(NUMBERS, SAME, SURFACE, SURFACE, fill_below="low"),  # type: ignore[arg-type]
    "confidence of two": lambda: zo.transfer(NUMBERS, SAME, SURFACE, SURFACE, fill_below=np.ones(2)),  # type: ignore[arg-type]
    "vertices of different lengths": lambda: zo.Surface([[0, 0, 0], [1, 0], [0, 1, 0]], [[0, 1, 2]]),
    "a face within a face": lambda: zo.Surface(np.eye(3), [[0, 1, [2, 0]]]),  # type: ignore[list-item]
    "a face of nothing": lambda: zo.Surface(np.eye(3), [[0, 1, 2], None]),  # type: ignore[list-item]
    "edges of different lengths": lambda: zo.Surface(np.eye(3), [[0, 1, 2]], [[0, 1], [2]]),
    "corners of different lengths": lambda: zo.Surface.from_corners(np.eye(3), [[0], [1, 2]], [0, 3]),
    "a number as corners": lambda: zo.Surface.from_corners(np.eye(3), 3, [0, 3]),
    "corners in a table": lambda: zo.Surface.from_corners(np.eye(3), [[0, 1, 2]], [0, 3]),
    "a triangulation of pairs": lambda: zo.Surface.from_corners(np.eye(3), [0, 1, 2], [0, 3], [0, 1]),
    "nothing joined": lambda: zo.Surface.joined([]),
    "a number joined": lambda: zo.Surface.joined([SURFACE, 3]),  # type: ignore[list-item]
    "regions of nothing": lambda: zo.match(SURFACE, SURFACE, regions=[None], initial="proximity"),
    "landmarks of different lengths": lambda: zo.match(SURFACE, SURFACE, landmarks=([[0, 0], [1]], [0, 1])),
    "an initial map of different lengths": lambda: zo.match(
        SURFACE, SURFACE, initial="given", initial_map=[[1], [1, 2]], k_final=20
    ),
    "a functional map of different lengths": lambda: zo.zoomout(BASIS, BASIS, [[1], [1, 2]], k_final=20),
    "a listener that cannot be called": lambda: zo.match(SURFACE, SURFACE, progress=3),  # type: ignore[arg-type]
    "no path for a result": lambda: SAME.save(None),  # type: ignore[arg-type]
    "a null character in a path": lambda: SAME.save("a\0b.npz"),
    "no path of a result": lambda: zo.load_result(None),  # type: ignore[arg-type]
    "a surface as an asset": lambda: zo.write_asset(SURFACE, "a.glb"),  # type: ignore[arg-type]
    "a word as kinds": lambda: zo.transfer_asset(zo.Asset(SURFACE), zo.Asset(SURFACE), SAME, kinds="uv"),
    "nothing as kinds": lambda: zo.transfer_asset(zo.Asset(SURFACE), zo.Asset(SURFACE), SAME, kinds=None),  # type: ignore[arg-type]
    "masked labels": lambda: moved(np.ma.masked_less(np.arange(100), 3), zo.Kind.LABEL),
    "masked text": lambda: moved(np.ma.array(["a"] * 100, mask=np.eye(100)[0]), zo.Kind.LABEL),
    "masked faces": lambda: zo.Surface(SURFACE.vertices, np.ma.masked_equal(SURFACE.triangles, 5)),
    "masked vertices of faces": lambda: zo.Surface(np.ma.masked_greater(SURFACE.vertices, 0), SURFACE.triangles),
    "dates as positions": lambda: zo.Surface(SURFACE.vertices.astype("datetime64[s]"), SURFACE.triangles),
    "an extent too small for areas": lambda: zo.Surface(1e-100 * SURFACE.vertices, SURFACE.triangles),
    "words to interpolate": lambda: SAME.interpolate(np.array(["a"] * 100)),
    "a sparse matrix to interpolate": lambda: SAME.interpolate(csr_array(np.eye(100))),
    "fewer labels than columns": lambda: zo.transfer(
        zo.Attribute("it", zo.Domain.POINT, zo.Kind.WEIGHT, csr_array(np.ones((100, 2))), labels=("one",)),
        SAME,
        SURFACE,
        SURFACE,
    ),
    "a radius in words": lambda: zo.shot(SURFACE, "wide"),  # type: ignore[arg-type]
    "errors of fractions": lambda: zo.geodesic_error(np.full(100, 0.5), SURFACE, np.arange(100), np.arange(100)),
    "smoothness in words": lambda: zo.wrap(SAME, SURFACE, SURFACE, smoothness="high"),  # type: ignore[arg-type]
    "a mask in words": lambda: zo.wrap(SAME, SURFACE, SURFACE, mask="all"),
    "stiffness in words": lambda: zo.dress(SAME, SURFACE, SURFACE, [SURFACE], stiffness="stiff"),  # type: ignore[arg-type]
    "a gap in words": lambda: zo.dress(SAME, SURFACE, SURFACE, [SURFACE], gap="wide"),  # type: ignore[arg-type]
    "a blend in words": lambda: Blend(factor="half"),  # type: ignore[arg-type]
    "a number as clothes": lambda: zo.dress(SAME, SURFACE, SURFACE, [3]),  # type: ignore[list-item]
    "clothes without a list": lambda: zo.dress(SAME, SURFACE, SURFACE, SURFACE),  # type: ignore[arg-type]
    "keys in words": lambda: zo.follow_keys(SURFACE, "smile", [SURFACE]),
    "joints in a plane": lambda: zo.move_joints(SURFACE, SURFACE.vertices, np.zeros((2, 2))),
    "joints in words": lambda: zo.move_joints(SURFACE, SURFACE.vertices, "knee"),
    "moved vertices in words": lambda: zo.move_joints(SURFACE, "up", np.zeros((1, 3))),
    "no bases": lambda: zo.consistent_zoomout([], {}),
    "numbers as bases of many": lambda: zo.consistent_zoomout([BASIS, 3], {}),  # type: ignore[list-item]
    "one name of a key": lambda: zo.translate_key_names("jawOpen", "arkit"),
    "numbers as names of keys": lambda: zo.recognise_key_names([1, 2]),  # type: ignore[list-item]
    "no names of keys": lambda: zo.missing_key_names(None, "arkit"),  # type: ignore[arg-type]
    "landmarks along a number": lambda: zo.transfer_landmarks(3, [1]),  # type: ignore[arg-type]
    "a mirror image of a number": lambda: zo.mirror_candidate(3),  # type: ignore[arg-type]
    "a face without keys": lambda: zo.propose_face_landmarks(SURFACE, None),  # type: ignore[arg-type]
    "keys of a number of vertices": lambda: zo.propose_face_landmarks(
        SURFACE, zo.Attribute("keys", zo.Domain.POINT, zo.Kind.OFFSET, np.zeros((99, 1, 3)), ("blink",))
    ),
    "libraries in words": lambda: zo.find_source(SURFACE, "characters"),  # type: ignore[arg-type]
    "half an asset to compare": lambda: zo.find_source(SURFACE, [], 0.5),  # type: ignore[arg-type]
    "a number as a cache": lambda: zo.store_shapes(3),  # type: ignore[arg-type]
    "a cache of words": lambda: zo.store_shapes("cache", "large"),  # type: ignore[arg-type]
    "a triangle beyond the target": lambda: SAME.at(SURFACE, SURFACE, np.array([10**6]), np.array([[1.0, 0, 0]])),
    "a shape of a collection above its folder": lambda: zo.match_collection(
        {"a": SURFACE, "../b": SURFACE}, template="a"
    ),
    "a number as the name of a shape": lambda: zo.match_collection({"a": SURFACE, 3: SURFACE}, template="a"),  # type: ignore[dict-item]
    "three lists of landmarks to wrap by": lambda: zo.wrap(SAME, SURFACE, SURFACE, landmarks=([1], [2], [3])),  # type: ignore[arg-type]
    "a parent that is not a number": lambda: zo.move_rig(SAME, SURFACE, SURFACE, np.eye(3)[:2], [np.nan, 0]),
    "a parent of nothing": lambda: zo.move_rig(SAME, SURFACE, SURFACE, np.eye(3)[:2], [None, 0]),  # type: ignore[list-item]
    "half a parent": lambda: zo.move_rig(SAME, SURFACE, SURFACE, np.eye(3)[:2], [-1, 0.5]),
    "no kinds": lambda: zo.transfer_asset(zo.Asset(SURFACE), zo.Asset(SURFACE), SAME, kinds=()),
    "a map of one axis": lambda: zo.orthonormality_error(np.ones(3)),
    "no pairs to measure": lambda: zo.geodesic_error(SAME, SURFACE, [0], [0], max_count=0),  # type: ignore[arg-type]
    "pairs in words": lambda: zo.match_collection({"a": SURFACE, "b": SURFACE}, pairs="some"),  # type: ignore[arg-type]
    "a pair of three": lambda: zo.match_collection({"a": SURFACE, "b": SURFACE}, pairs=[("a", "b", "a")]),  # type: ignore[list-item]
    "no neighbours": lambda: zo.match_collection({"a": SURFACE, "b": SURFACE}, neighbours=0),
    "half a neighbour": lambda: zo.match_collection({"a": SURFACE, "b": SURFACE}, neighbours=1.5),  # type: ignore[arg-type]
    "a file as the folder of a collection": lambda: zo.match_collection([SURFACE, SURFACE], __file__, pairs="all"),
    "no folder of a library": lambda: zo.Library(None),  # type: ignore[arg-type]
    "a single folder to read from": lambda: zo.read_asset(__file__, folders="textures"),
    "a single input": lambda: zo.write_asset(zo.Asset(SURFACE), "a.glb", inputs="b.glb"),
    "a cloud of faces": lambda: zo.match(SURFACE, ([0, 1, 2], SURFACE.vertices)),
}


def test_too_small_extent_is_named() -> None:
    with pytest.raises(MeshError, match=r"extent of only [0-9]e-100: scale it up"):
        zo.Surface(1e-100 * SURFACE.vertices, SURFACE.triangles)


def test_masked_vertices_of_no_face_are_accepted() -> None:
    vertices = np.ma.masked_greater(np.vstack([SURFACE.vertices, np.full(3, 99.0)]), 9)
    assert zo.Surface(vertices, SURFACE.triangles).area == SURFACE.area


def test_masked_numbers_are_filled_in_and_counted() -> None:
    moved_on = moved(np.ma.masked_less(np.arange(100.0), 3), zo.Kind.SCALAR)
    assert moved_on.values.min() >= 3
    assert "3 of 100 values of 'it' are not finite" in moved_on.notes[0]


@pytest.mark.parametrize("name", ["b/..", "b/c", "..", "", "b\\c"])
def test_shapes_of_a_collection_are_written_in_its_folder(name: str, tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="its files need a name, without slashes"):
        zo.match_collection({"a": SURFACE, name: SURFACE}, tmp_path / "out", template="a")
    assert [path.name for path in tmp_path.rglob("*.ply")] == ["a.ply"]


def test_negative_weights_are_noted() -> None:
    weights = csr_array(np.column_stack([np.full(100, -1.0), np.ones(100)]))
    found = moved(weights, zo.Kind.WEIGHT)
    assert found.values.toarray().tolist() == [[0, 1]] * 100
    assert found.notes == ("it: 100 negative weights count as 0.",)


@pytest.mark.parametrize("name", WRONG)
def test_wrong_types_raise_one_sentence(name: str) -> None:
    with pytest.raises((TypeError, ValueError, OutputError), match=r"(?s)^\S.*[a-z:].*\.$") as raised:
        WRONG[name]()
    assert not re.search(r"inhomogeneous|truth value|ufunc|not supported between|object has no", str(raised.value))


@pytest.mark.parametrize(
    ("option", "sentence"),
    [
        ("k_fina", r"match has no option k_fina: did you mean k_final\?"),
        ("colour", "match has no option colour: choose from initial, "),
        ("detail", r"give its sizes, such as k_final=200 .*fine: k_final=200, samples=1500, proxy_vertices=8000"),
    ],
)
def test_unknown_option_suggests_replacement(option: str, sentence: str) -> None:
    with pytest.raises(TypeError, match=sentence):
        zo.match(SURFACE, SURFACE, **{option: "fine"})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("function", "old", "new"),
    [
        (zo.match_by_proximity, "most_distance", "max_distance"),
        (zo.match_by_proximity, "most_angle", "max_angle"),
        (zo.store_shapes, "most_bytes", "max_bytes"),
        (zo.plotting.plot_error_curves, "most_error", "max_error"),
        (zo.transfer_asset, "maxweights", "max_weights"),
        (zo.wrap, "smoothnes", "smoothness"),
        (zo.match_collection, "neighbors", "neighbours"),
        (zo.dress, "stifness", "stiffness"),
    ],
)
def test_old_or_misspelt_option_of_a_function_gets_a_suggestion(function: Any, old: str, new: str) -> None:
    with pytest.raises(TypeError, match=rf"{function.__name__} has no option {old}: did you mean {new}\?"):
        function(**{old: 1})


def test_labels_may_be_an_iterator() -> None:
    weights = csr_array(np.ones((100, 2)))
    given = zo.Attribute("it", zo.Domain.POINT, zo.Kind.WEIGHT, weights, iter(["a", "b"]))  # type: ignore[arg-type]
    assert zo.transfer(given, SAME, SURFACE, SURFACE).labels == ("a", "b")


def test_unknown_kind_lists_existing_kinds() -> None:
    asset = zo.Asset(SURFACE)
    result = zo.match_by_proximity(SURFACE, SURFACE)
    with pytest.raises(ValueError, match="Unknown kind 'uvs': choose from uv, color, materials"):
        zo.transfer_asset(asset, asset, result, kinds=("uvs",))


def test_folder_is_refused_as_a_file(tmp_path: Path) -> None:
    assert_refused(run(main, "info", tmp_path), f"{tmp_path} is a folder: give a file.")


@pytest.mark.parametrize(("name", "package"), [("scan.dae", "collada"), ("scan.3mf", "networkx")])
def test_the_extra_that_a_format_needs_is_named(
    name: str, package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import trimesh

    missing = trimesh.exceptions.ExceptionWrapper(ImportError(f"missing `pip install {package}`"))
    monkeypatch.setitem(sys.modules, package, None)
    for ending in ("dae", "zae", "3mf"):
        monkeypatch.setitem(trimesh.exchange.load.mesh_loaders, ending, missing)
    path = tmp_path / name
    with ZipFile(path, "w"):
        pass
    ran = run(main, "info", path)
    assert_refused(ran, "requires a package that is not installed: in the checkout, pip install '.[formats]'")


def test_misspelt_symmetry_option_gets_a_suggestion() -> None:
    detect: Any = zo.detect_symmetry
    with pytest.raises(TypeError, match=r"detect_symmetry has no option sede: did you mean seed\?"):
        detect(SURFACE, sede=1)
    with pytest.raises(TypeError, match="detect_symmetry has no option qqq: choose from surface, max_count, left"):
        detect(SURFACE, qqq=1)


@pytest.mark.parametrize("vertices", [[[10**400, 0, 0]] * 3, np.eye(3) * 1j])
def test_non_real_positions_are_refused(vertices: Any) -> None:
    with pytest.raises(MeshError, match="Positions must be numbers, three for each vertex"):
        zo.Surface(vertices, [[0, 1, 2]])


def test_huge_points_are_refused() -> None:
    with pytest.raises(MeshError, match="not finite or far too large: remove them"):
        zo.PointCloud(np.random.default_rng(0).random((50, 3)) * 1e200)


def test_directions_of_any_length_are_normalised() -> None:
    np.testing.assert_allclose(check_axes([1e308, 1e308, 0]), [[0.5**0.5, 0.5**0.5, 0]])
    np.testing.assert_allclose(check_axes([0, 1e-300, 0]), [[0, 1, 0]])


@pytest.mark.parametrize("name", ["SCALAR", "uv", "Color"])
def test_kind_given_as_text_suggests_the_enum(name: str) -> None:
    with pytest.raises(
        TypeError, match=rf"the attribute 'it' is '{name}': give a zo.Kind, such as zo.Kind.{name.upper()}"
    ):
        attribute(kind=name)


def test_a_functional_map_of_huge_values_is_doubtful() -> None:
    options: Any = {"initial": "given", "k_final": 20, "samples": 60}
    result = zo.match(SURFACE, creature(130, seed=1).surface, initial_map=np.full((20, 20), 1e308), **options)
    assert result.verdict.level == "red"


def test_folder_is_refused_as_result_file(tmp_path: Path) -> None:
    (tmp_path / "it.npz").mkdir()
    with pytest.raises(OutputError, match=r"it\.npz is a folder: give the name of a file in it"):
        SAME.save(tmp_path / "it")
