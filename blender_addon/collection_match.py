"""Characters of several objects: body, eyes, teeth, clothes, each with its counterpart in another collection.

All objects of a collection are matched as one surface, of which the core pairs the parts; then each target keeps the
match with the one source that most of it lies on, as if the two had been matched alone.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from bpy.types import Collection, Context

import zoomout_core as zo
from zoomout_core.arrays import Integers
from zoomout_core.correspondence.detail import DETAIL
from zoomout_core.progress import Steps, drain
from zoomout_core.projection import closest_points

from . import mesh_data, stored_match
from .pair import check_writable, find_mesh, read_pair
from .stored_match import StoredMatch
from .targets import Write

# What Blender appends to a name that is taken.
COPY = re.compile(r"\.\d{3,}$")


@dataclass(frozen=True, eq=False)
class Parts:
    """The objects of a collection as one surface.

    Attributes:
        names: of the objects.
        surfaces: of each.
        joined: all of them.
        first_vertex: (p + 1,) the first vertex of each in the joined surface, and their number.
        first_triangle: (p + 1,) the first triangle of each, and their number.
    """

    names: tuple[str, ...]
    surfaces: tuple[zo.Surface, ...]
    joined: zo.Surface
    first_vertex: Integers
    first_triangle: Integers

    @classmethod
    def of(cls, names: Sequence[str], surfaces: Sequence[zo.Surface]) -> Parts:
        """Those of these names and surfaces."""
        vertices = np.cumsum([0, *(len(surface.vertices) for surface in surfaces)])
        triangles = np.cumsum([0, *(len(surface.triangles) for surface in surfaces)])
        return cls(tuple(names), tuple(surfaces), zo.Surface.joined(surfaces), vertices, triangles)


def match_collections(
    context: Context, source: Collection, target: Collection, **options: Any
) -> dict[str, tuple[str, StoredMatch]]:
    """Match the meshes of two collections, and keep on each of the target's the match with its counterpart.

    Args:
        context: Blender's; the objects are in its scene.
        source: its meshes have the data; read as their modifiers leave them.
        target: its meshes receive the data.
        options: `detail`, one of `DETAIL`, and those of `zoomout_core.match`.

    Returns:
        For the name of each target that of its source, and the match.

    Raises:
        MeshError: an object cannot be used; nothing was written.
    """
    return drain(match_collections_steps(context, source.name, target.name, **options))


def match_collections_steps(
    context: Context, source: str, target: str, **options: Any
) -> Steps[dict[str, tuple[str, StoredMatch]]]:
    """`match_collections` as a generator, which holds no Blender data while it is suspended."""
    write = yield from worked_out_collections_steps(context, source, target, **options)
    return write()


def worked_out_collections_steps(
    context: Context, source: str, target: str, detail: str = "balanced", **options: Any
) -> Steps[Write[dict[str, tuple[str, StoredMatch]]]]:
    """The same without the end: it returns what keeps the matches."""
    sources, targets = _read(context, source, False), _read(context, target, True)
    if shared := set(sources.names) & set(targets.names):
        raise zo.MeshError(f"'{min(shared)}' is in both collections: choose two that share no mesh.")
    arguments = DETAIL[detail] | {"regions": _same_names(sources, targets)} | options
    result = yield from zo.match_steps(sources.joined, targets.joined, **arguments)
    matches = {name: _alone(result, sources, targets, i) for i, name in enumerate(targets.names)}

    def write() -> dict[str, tuple[str, StoredMatch]]:
        pairs = {name: read_pair(context, source_name, name) for name, (source_name, _) in matches.items()}
        for name, pair in pairs.items():
            _check_same(pair.source_name, sources, pair.source)
            _check_same(name, targets, pair.target)
        for name, pair in pairs.items():
            stored_match.write(context.scene.objects[name].data, matches[name][1], pair, options | {"detail": detail})
        return matches

    return write


def _check_same(name: str, parts: Parts, now: zo.Surface) -> None:
    """Raise a MeshError if an object is no longer what it was when it was read."""
    before = parts.surfaces[parts.names.index(name)]
    if not (np.array_equal(before.vertices, now.vertices) and np.array_equal(before.triangles, now.triangles)):
        raise zo.MeshError(f"'{name}' was edited while it was being worked on: start again.")


def _read(context: Context, collection: str, writing: bool) -> Parts:
    """The meshes of a collection that have faces; of those that share one, the first."""
    found = context.blend_data.collections.get(collection)
    if found is None:
        raise zo.MeshError(f"There is no collection '{collection}': choose another one.")
    objects = {obj.data: obj for obj in reversed(found.all_objects) if obj.type == "MESH" and obj.data.polygons}
    names = [obj.name for obj in reversed(objects.values())]
    if not names:
        raise zo.MeshError(f"There is no mesh in the collection '{collection}': choose another one.")
    depsgraph = context.evaluated_depsgraph_get()
    read = mesh_data.read_target_surface if writing else mesh_data.read_source_surface
    for name in names if writing else ():
        check_writable(find_mesh(context, name))
    return Parts.of(names, [read(find_mesh(context, name), depsgraph) for name in names])


def _same_names(sources: Parts, targets: Parts) -> list[tuple[Integers, Integers]]:
    """Vertices of the joined surfaces for each two objects of the same name but for the number that Blender appends."""
    by_name = {COPY.sub("", name): i for i, name in enumerate(sources.names)}
    return [
        (np.arange(*sources.first_vertex[j : j + 2]), np.arange(*targets.first_vertex[i : i + 2]))
        for i, name in enumerate(targets.names)
        for j in [by_name.get(COPY.sub("", name))]
        if j is not None
    ]


def _alone(result: zo.MatchResult, sources: Parts, targets: Parts, number: int) -> tuple[str, StoredMatch]:
    """The source that most of a target lies on, by how far that is trusted, and the match with that one alone."""
    own = slice(*targets.first_vertex[number : number + 2])
    triangle, barycentric = result.surface_map.triangle[own].copy(), result.surface_map.barycentric[own].copy()
    confidence = result.confidence[own].copy()
    owner = np.searchsorted(sources.first_triangle, triangle, side="right") - 1
    chosen = int(np.argmax(np.bincount(owner, confidence + 1e-6, minlength=len(sources.names))))
    surface, elsewhere = sources.surfaces[chosen], np.flatnonzero(owner != chosen)
    triangle -= sources.first_triangle[chosen]
    notes = list(result.notes)
    if len(elsewhere):
        images = result.surface_map.interpolate(sources.joined.vertices)[own][elsewhere]
        triangle[elsewhere], barycentric[elsewhere] = closest_points(images, surface.vertices, surface.triangles)
        confidence[elsewhere] = 0
        notes.append(
            f"{len(elsewhere)} vertices lie on other objects than '{sources.names[chosen]}': its nearest point, "
            "with no confidence."
        )
    surface_map = zo.SurfaceMap(triangle, barycentric, surface.triangles)
    return sources.names[chosen], StoredMatch(surface_map, confidence, tuple(notes))
