# SPDX-License-Identifier: GPL-3.0-or-later
"""Review transferred keys: edges that they stretch, faces that they push through others, and a sheet of all keys."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.arrays import Booleans, Bytes, Floats, Integers
from zoomout_core.drawing import draw_triangles
from zoomout_core.expression_sheet import INK, PAPER, Head, draw_sheet
from zoomout_core.runtime.progress import advance, portion, stage
from zoomout_core.transfer.keys.intersections import Intersections
from zoomout_core.transfer.rigging.stretch import play_offsets, stretched_edges

from .. import mesh_data
from ..colors import stretched_colors
from ..jobs import run
from ..scene.pair import find_mesh
from ..scene.stored_pair import read_stored_match
from ..storage.stored_match import Match

# Height of letters, relative to that of their line, and their distance from its left and lower border.
LETTERS, INDENT, BASE = 0.75, 0.25, 0.3
# Fractions of the progress until stretched edges, and until intersections are found.
STRETCHED, INTERSECTING = 0.1, 0.5


@dataclass(frozen=True, eq=False)
class _Parts:
    """Objects at rest, joined in their order.

    Attributes:
        surface: their meshes, in world space.
        keys: by name, the offsets (n, 3) of each key at full strength, in world space.
        vertices: the numbers of the vertices of each object, by its name.
        triangles: the number of triangles of each object.
    """

    surface: zo.Surface
    keys: dict[str, Floats]
    vertices: dict[str, Integers]
    triangles: dict[str, int]

    @property
    def head(self) -> Head:
        """The head to draw."""
        return Head(self.surface.vertices, self.surface.triangles, self.keys)


@dataclass(frozen=True)
class Review:
    """Faults found in transferred keys.

    Attributes:
        sheet: picture of all keys, (height, width, 3), rows from top to bottom.
        stretched: by target and key, the number of vertices at edges that stretch much more than on the source; only
            where there are some.
        intersecting: by name, the number of vertices of faces that intersect others, see `Intersections`.
    """

    sheet: Bytes
    stretched: dict[str, dict[str, int]] = field(default_factory=dict)
    intersecting: dict[str, dict[str, int]] = field(default_factory=dict)


def review_expressions(context: Context, sources: Sequence[str], matches: Mapping[str, tuple[str, Match]]) -> Review:
    """Draw the keys of objects beside those of their targets.

    Args:
        context: Blender's.
        sources: names of the objects with the keys.
        matches: by the name of each target, the name of its first source, and its match.

    Raises:
        MeshError: no source has shape keys.
    """
    source, target = _read_parts(context, sources), _read_parts(context, list(matches))
    if not source.keys:
        raise zo.MeshError("'{name}' has no shape keys: add or transfer some first.", name=sources[0])
    marks = {key: np.zeros(len(target.surface.vertices), dtype=bool) for key in source.keys}
    stretched: dict[str, dict[str, int]] = {}
    intersecting: dict[str, dict[str, int]] = {name: {} for name in matches}
    with portion(0, STRETCHED), stage("Looking for stretched edges"):
        for name, (first, match) in matches.items():
            own = find_stretched(context, _sources_of(first, match), name, match)
            stretched[name] = {key: int(found.sum()) for key, found in own.items() if found.any()}
            for key, found in own.items():
                marks[key][target.vertices[name]] = found
    with portion(STRETCHED, INTERSECTING), stage("Looking for intersections"):
        intersections = _read_intersections(source, target, matches)
        shared = [key for key in source.keys if key in target.keys]
        for number, key in enumerate(shared):
            advance(number / len(shared))
            found = intersections.find(source.keys[key], target.keys[key])
            marks[key] |= found
            counts = {name: int(found[numbers].sum()) for name, numbers in target.vertices.items()}
            for name in matches:
                intersecting[name] |= {key: counts[name]} if counts[name] else {}
    with portion(INTERSECTING, 1):
        return Review(draw_sheet(source.head, target.head, marks, _draw_text), stretched, intersecting)


def _sources_of(first: str, match: Match) -> list[str]:
    """The names of the objects that a match leads to, by the name of the first one."""
    return [first, *getattr(match, "others", ())]


def _read_intersections(source: _Parts, target: _Parts, matches: Mapping[str, tuple[str, Match]]) -> Intersections:
    """The finder of intersections on targets, by their names and their matches with the first of their sources."""
    images = np.full((len(target.surface.vertices), 3), -1)
    for name, (first, match) in matches.items():
        names, corners = _sources_of(first, match), match.surface_map.source_triangles
        if sum(source.triangles[each] for each in names) == len(corners):  # otherwise modifiers change their faces
            numbers = np.concatenate([source.vertices[each] for each in names])
            images[target.vertices[name]] = numbers[corners[match.surface_map.triangle]]
    return Intersections(source.surface, target.surface, images, mesh_data.intersecting_triangles)


@dataclass(frozen=True, eq=False)
class Faults:
    """The faults of the keys of a matched object.

    Attributes:
        sources: names of the objects that it was matched with; none if it has no match.
        stretched: by key, the vertices (n_t,) at edges that stretch much more than on the source.
        keys: by key that both have, its offsets on the sources (n_s, 3) and on the object (n_t, 3).
        intersections: finds faces that intersect others; None if there is no match.
        content: hash of the object's mesh, see `mesh_data.content_hash`.
    """

    sources: tuple[str, ...]
    stretched: dict[str, Booleans]
    keys: dict[str, tuple[Floats, Floats]]
    intersections: Intersections | None
    content: str

    def colors(self, key: str) -> Floats | None:
        """(n_t, 3) colours of the vertices for a key; None if it has no fault.

        Intersections are computed when a key is first coloured, since those of all keys take seconds.
        """
        if self.intersections is None or key not in self.keys:
            return None
        if key not in self._found:
            self._found[key] = self.intersections.find(*self.keys[key]) | self.stretched.get(key, False)
        found = self._found[key]
        return stretched_colors(found) if found.any() else None

    @cached_property
    def _found(self) -> dict[str, Booleans]:
        return {}


def faults_of_keys(context: Context, target: Object) -> Faults:
    """The faults of an object's keys, along its stored match; none without a valid match.

    Intersections are those of the object with itself.
    """
    content = mesh_data.content_hash(target.data)
    try:
        pair, match = run(read_stored_match(context, target.name))
    except zo.MeshError:  # no match, or a mesh was edited since
        return Faults((), {}, {}, None, content)
    names = pair.source_names
    source, own = _read_parts(context, names), _read_parts(context, [target.name])
    keys = {key: (source.keys[key], own.keys[key]) for key in source.keys if key in own.keys}
    intersections = _read_intersections(source, own, {target.name: (names[0], match)})
    return Faults(names, find_stretched(context, names, target.name, match), keys, intersections, content)


def has_keys(context: Context, name: str) -> bool:
    """Whether an object has shape keys besides the Basis."""
    return bool(mesh_data.names_of_keys(find_mesh(context, name)))


def find_stretched(context: Context, sources: Sequence[str], target: str, match: Match) -> dict[str, Booleans]:
    """The vertices (n_t,) of a target at edges that its keys stretch much more than on the source, by key.

    Args:
        context: Blender's.
        sources: names of the objects that the target maps to.
        target: name of the target.
        match: its match.

    Returns:
        Nothing for keys that one of them lacks, nor if modifiers change the faces of a source.
    """
    source, own = _read_parts(context, sources), _read_parts(context, [target])
    size = float(np.ptp(own.surface.vertices, axis=0).max())
    found: dict[str, Booleans] = {}
    if len(source.surface.triangles) != len(match.surface_map.source_triangles):
        return found  # modifiers of the source change its faces
    shared = [key for key in source.keys if key in own.keys]
    played = (play_offsets(each.surface, [each.keys[key] for key in shared]) for each in (source, own))
    for key, of_source, of_target in zip(shared, *played, strict=True):
        edges = of_target.edges[stretched_edges(of_source, of_target, match.surface_map, size)]
        found[key] = np.isin(np.arange(len(own.surface.vertices)), edges)
    return found


def _read_parts(context: Context, names: Iterable[str]) -> _Parts:
    objects = [find_mesh(context, name) for name in names]
    surfaces, keys, vertices, count = list[zo.Surface](), list[dict[str, Floats]](), dict[str, Integers](), 0
    for obj in objects:
        at_rest = mesh_data.read_surface_at_rest(obj, positions=mesh_data.read_rest_positions(obj.data))
        surfaces.append(at_rest.with_vertices(mesh_data.positions_in_world(obj, at_rest.vertices)))
        keys.append(_offsets_in_world(obj))
        vertices[obj.name] = count + np.arange(len(at_rest.vertices))
        count += len(at_rest.vertices)
    joined = {name: np.zeros((count, 3)) for own in keys for name in own}
    for obj, own in zip(objects, keys, strict=True):
        for name, offsets in own.items():
            joined[name][vertices[obj.name]] = offsets
    triangles = {obj.name: len(each.triangles) for obj, each in zip(objects, surfaces, strict=True)}
    return _Parts(zo.Surface.joined(surfaces), joined, vertices, triangles)


def _offsets_in_world(obj: Object) -> dict[str, Floats]:
    own = mesh_data.read_full_offsets(obj)
    return {name: mesh_data.directions_in_world(obj, offsets) for name, offsets in own.items()}


def _draw_text(text: str, height: int, width: int) -> Bytes:
    """A line of text, smaller if it is too long."""
    points, triangles = mesh_data.text_triangles(text)
    size = LETTERS * height
    longest = float(points[:, 0].max(initial=0)) + 2 * INDENT
    size = min(size, width / longest)
    placed = np.column_stack([points * size + [INDENT * size, BASE * height], np.zeros(len(points))])
    return draw_triangles(placed, triangles, np.tile(INK, (len(points), 1)), width, height, PAPER)
