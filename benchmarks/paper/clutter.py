# SPDX-License-Identifier: GPL-3.0-or-later
"""An animal in a cut and cluttered scene: ZoomOut in a Hamiltonian basis, compared with LMH and PFM."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import cycle
from pathlib import Path
from time import perf_counter

import numpy as np
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.baselines.bcicp import Side
from benchmarks.baselines.lmh import GLOBAL, kernels, lmh, localized_harmonics, transport
from benchmarks.baselines.pfm import pfm
from benchmarks.datasets import CORRESPONDENCE, PairOfParts
from benchmarks.generate.folder import class_of
from benchmarks.paper.partial import RADIUS, figures
from benchmarks.pictures import View, draw_views
from benchmarks.tables import Record, Tables
from zoomout_core.arrays import Floats, Integers
from zoomout_core.colors import place_colors
from zoomout_core.mesh.decimation import decimate
from zoomout_core.mesh.formats.files import read_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph
from zoomout_core.mesh.voxel_remesh import voxel_remesh
from zoomout_core.spectral.eigenbasis import SpectralBasis
from zoomout_core.spectral.sampling import farthest_points

SCENES = 6
# Number of voxels along a scene's longest extent, and number of vertices after decimation.
RESOLUTION, VERTICES = 160, 6000
# Fraction of the animal's longest extent that the cut leaves, and depth of the clutter in it, in voxels.
KEPT, DEPTH = 0.7, 2.0
# A place of the animal is in the scene if a vertex of the scene is within this number of edge lengths.
SEEN = 1.0
# Number of sparse matches given to LMH and ZoomOut, and standard deviation of their Gaussians, relative to the root of
# the model's area.
MATCHES, SPREAD = 12, 0.15
# Sizes of functional maps in localised bases: increasing ones, and the fixed one of LMH.
K_INITIAL, K_FINAL, STEP, K_FIXED = 20, 100, 5, 50
GREY = 0.75
# Scenes in the figure.
DRAWN = 3


@dataclass(frozen=True, eq=False)
class Scene(PairOfParts):
    """A posed animal in a scene that lacks some of it and has other objects.

    Attributes:
        name: of the model and of the scene's contents.
        source: the scene.
        target: the model, in one unit with it.
        truth: (n_t,) source vertex of each target vertex; -1 where the scene lacks it.
        matches: (m, 2) target and source vertices that correspond.
    """

    matches: Integers

    @cached_property
    def scale(self) -> float:
        """The target's area over the source's."""
        return self.target.area / self.source.area

    @cached_property
    def potentials(self) -> tuple[Floats, Floats]:
        """(n_s,) and (n_t,) potentials: 0 at the matches, 1 far from all of them."""
        on_target, on_source = self.matches.T
        width = SPREAD * np.sqrt(self.target.area)
        return potential(self.source, on_source, width), potential(self.target, on_target, width)

    def localise(self, k: int) -> tuple[SpectralBasis, SpectralBasis]:
        """Hamiltonian bases of source and target, in one unit."""
        of_source, of_target = self.potentials
        return (
            zo.hamiltonian_basis(self.source, of_source, k),
            zo.hamiltonian_basis(self.target, of_target, k).at_area(self.scale),
        )


def potential(surface: Surface, vertices: Integers, width: float) -> Floats:
    """(n,) one minus the sum of Gaussians of the geodesic distances from some vertices, at least zero."""
    apart = dijkstra(edge_graph(surface.vertices, surface.triangles), indices=vertices)
    return np.asarray(np.maximum(1 - np.exp(-(apart**2) / (2 * width**2)).sum(axis=0), 0))


# --- methods ------------------------------------------------------------------------------------------------


def _first(scene: Scene, bases: tuple[SpectralBasis, SpectralBasis]) -> Floats:
    """(K_INITIAL, K_INITIAL) functional map that maps heat kernels at the matches to each other."""
    on_target, on_source = scene.matches.T
    small = [_leading(basis, K_INITIAL) for basis in bases]
    return transport(kernels(small[0], on_source), kernels(small[1], on_target))


def _leading(basis: SpectralBasis, k: int) -> SpectralBasis:
    return SpectralBasis(basis.eigenvalues[:k], basis.eigenvectors[:, :k], basis.areas, basis.points, basis.components)


def _initial(scene: Scene) -> Integers:
    bases = scene.localise(K_FINAL)
    return zo.vertex_map_of(_first(scene, bases), *bases)


def _zoomout(scene: Scene) -> Integers:
    bases = scene.localise(K_FINAL)
    return zo.zoomout(*bases, _first(scene, bases), K_FINAL, STEP, samples=None).vertex


def _whole_zoomout(scene: Scene) -> Integers:
    """The same in the Laplacian eigenfunctions of the whole scene and model."""
    source, target = zo.eigenbasis(scene.source, K_FINAL), zo.eigenbasis(scene.target, K_FINAL).at_area(scene.scale)
    return zo.zoomout(source, target, _first(scene, (source, target)), K_FINAL, STEP, samples=None).vertex


def _lmh(scene: Scene) -> Integers:
    bases = [
        localized_harmonics(surface, zo.eigenbasis(surface, GLOBAL), barrier, K_FIXED)
        for surface, barrier in zip((scene.source, scene.target), scene.potentials, strict=True)
    ]
    return lmh(bases[0], bases[1].at_area(scene.scale), scene.matches)


def _pfm(scene: Scene) -> Integers:
    """PFM without matches, with the model as a part of the scene."""
    source, target = (Side(surface, zo.eigenbasis(surface, K_FINAL)) for surface in (scene.source, scene.target))
    of_source = zo.shot(scene.source, RADIUS * np.sqrt(scene.scale))
    return pfm(source, target, of_source, zo.shot(scene.target, RADIUS), K_FINAL).vertex


def _match(scene: Scene) -> Integers:
    zo.forget_shapes()
    return zo.match(scene.source, scene.target).surface_map.vertex


METHODS: dict[str, Callable[[Scene], Integers]] = {
    "initial, from the matches": _initial,
    "LMH": _lmh,
    "PFM": _pfm,
    "ZoomOut, whole bases": _whole_zoomout,
    "ZoomOut": _zoomout,
    "zo.match, nothing given": _match,
}


# --- tables -------------------------------------------------------------------------------------------------


def run(data: Path, pairs: int | None, figure: Path | None) -> Tables:
    """Match models to scenes with a cut copy of them in another pose, next to another animal.

    Scenes are made from the set `tosca_r`: an animal in one pose and one of another class are joined by the
    skin around both, and cut by a plane. The map leads from the model to the scene. LMH and
    ZoomOut are given sparse true matches, and use functions on the region around these; PFM is given none.

    `rows`, for each method, over the model's vertices that exist in the scene: mean and median over the scenes of the
    mean geodesic error times 1000, mean share of the animal in the scene that their images cover, median seconds with
    bases and descriptors.

    Args:
        data: the folder of the sets, or the set.
        pairs: number of scenes, at most and by default `SCENES`.
        figure: an image file for the first scenes, with maps shown by transferred colours.

    Returns:
        The table, and under `pairs` a record for each scene and method.
    """
    folder = data / "tosca_r" if (data / "tosca_r").is_dir() else data
    if not (folder / CORRESPONDENCE).is_file():
        return {"rows": []}
    records: list[Record] = []
    drawn: list[list[View]] = []
    for chosen in tqdm(chosen_animals(folder, min(pairs or SCENES, SCENES)), desc="scenes", leave=False):
        scene = make_scene(folder, *chosen)
        vertices: dict[str, Integers] = {}
        for method, vertex_of in METHODS.items():
            begin = perf_counter()
            vertices[method] = vertex_of(scene)
            record = {"set": scene.name, "method": method, "seconds": perf_counter() - begin}
            records.append(record | figures(vertices[method], scene))
        if len(drawn) < DRAWN:
            drawn.append(_views(scene, vertices))
    if not records:
        return {"rows": []}
    if figure is not None:
        draw_views(figure, drawn)
    return {"rows": _rows(records), "pairs": records}


def _rows(records: list[Record]) -> list[Record]:
    rows = []
    for method in dict.fromkeys(record["method"] for record in records):
        chosen = [record for record in records if record["method"] == method]
        errors = [record["error"] for record in chosen]
        rows.append(
            {
                "method": method,
                "scenes": len(chosen),
                "mean": float(np.mean(errors)),
                "median": float(np.median(errors)),
                "covered %": float(np.mean([record["covered %"] for record in chosen])),
                "seconds": float(np.median([record["seconds"] for record in chosen])),
            }
        )
    return rows


def _views(scene: Scene, vertices: dict[str, Integers]) -> list[View]:
    """The scene with the animal in colours, and the model with the colours that each map transfers."""
    grey = np.full(3, GREY)
    colour = np.where(scene.region[:, None], place_colors(scene.source.vertices, scene.source.vertices), grey)
    seen = scene.truth >= 0
    maps = {"truth": scene.truth} | vertices
    carried = {name: np.where(seen[:, None], colour[vertex], grey) for name, vertex in maps.items()}
    return [
        View(scene.name, scene.source, colour),
        *(View(name, scene.target, shown) for name, shown in carried.items()),
    ]


# --- scenes -------------------------------------------------------------------------------------------------


def chosen_animals(folder: Path, count: int) -> list[tuple[str, str, str]]:
    """(model, the same animal in another pose, another animal) of some scenes, of all classes in turn."""
    with np.load(folder / CORRESPONDENCE) as truth:
        names = sorted(name for name in truth if not name.endswith(".sym"))
    classes: dict[str, list[str]] = {}
    for name in names:
        classes.setdefault(class_of(name), []).append(name)
    several = [kind for kind, members in classes.items() if len(members) > 1]
    if not several or len(classes) < 2:
        return []
    chosen = []
    for number, kind in zip(range(count), cycle(several)):
        members = classes[kind]
        others = [name for other, of_other in classes.items() if other != kind for name in of_other]
        pose = 1 + number // len(several) % (len(members) - 1)
        chosen.append((members[0], members[pose], others[(7 * number) % len(others)]))
    return chosen


def make_scene(folder: Path, model: str, pose: str, other: str) -> Scene:
    """The scene of an animal in some pose next to another one."""
    with np.load(folder / CORRESPONDENCE) as truth:
        on_model, on_pose = truth[model], truth[pose]
    target, posed, clutter = (read_surface(folder / f"{name}.off") for name in (model, pose, other))
    source = union_and_cut(posed, clutter)
    places = posed.vertices[on_pose]
    apart, nearest_vertex = map(np.asarray, cKDTree(source.vertices).query(places))
    edge = np.sqrt(source.area / len(source.vertices))
    seen = np.flatnonzero(apart < SEEN * edge)
    truth_of_target = np.full(len(target.vertices), -1)
    truth_of_target[on_model[seen]] = nearest_vertex[seen]
    picked = seen[farthest_points(places[seen], MATCHES)]
    matches = np.column_stack([on_model[picked], truth_of_target[on_model[picked]]])
    return Scene(f"{model} in {pose} + {other}", source, target, truth_of_target, matches)


def union_and_cut(animal: Surface, clutter: Surface) -> Surface:
    """The skin around an animal and another object that touches it, cut by a plane."""
    points = animal.vertices
    along = int(np.argmax(np.ptp(points, axis=0)))
    limit = points[:, along].min() + KEPT * np.ptp(points[:, along])
    kept = points[points[:, along] < limit]
    beside = int(np.argsort(np.ptp(points, axis=0))[0])
    moved = clutter.vertices * np.sqrt(animal.area / clutter.area)
    moved = moved + (kept.max(axis=0) + kept.min(axis=0) - moved.max(axis=0) - moved.min(axis=0)) / 2
    voxel = np.ptp(points[:, along]) / RESOLUTION
    moved[:, beside] += touching(points, moved, beside) - DEPTH * voxel
    vertices = np.vstack([points, moved])
    triangles = np.vstack([animal.triangles, clutter.triangles + len(points)])
    vertices, triangles = voxel_remesh(vertices, triangles, RESOLUTION)
    vertices, triangles, _ = decimate(vertices, triangles, VERTICES)
    # Everything beyond the plane is removed; the largest piece is kept.
    triangles = triangles[(vertices[triangles, along] < limit).all(axis=1)]
    piece = connected_components(edge_graph(vertices, triangles), directed=False)[1]
    largest = np.bincount(piece[triangles[:, 0]]).argmax()
    used, triangles = np.unique(triangles[piece[triangles[:, 0]] == largest], return_inverse=True)
    return Surface(vertices[used], triangles.reshape(-1, 3))


def touching(fixed: Floats, moving: Floats, axis: int) -> float:
    """The distance by which points (m, 3) must move along an axis to touch others (n, 3), by bisection."""
    tree = cKDTree(fixed)
    near = np.sqrt(np.ptp(fixed, axis=0).prod() ** (2 / 3) / len(fixed))
    low, high = 0.0, float(np.ptp(fixed[:, axis]) + np.ptp(moving[:, axis]))
    direction = np.eye(3)[axis]
    for _ in range(20):
        middle = (low + high) / 2
        is_near = np.min(tree.query(moving + middle * direction)[0]) < near
        low, high = (middle, high) if is_near else (low, middle)
    return low
