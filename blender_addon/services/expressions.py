# SPDX-License-Identifier: GPL-3.0-or-later
"""Review transferred expression keys: edges that they stretch, and a contact sheet of all keys."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.arrays import Booleans, Bytes, Floats
from zoomout_core.drawing import draw_triangles
from zoomout_core.expression_sheet import INK, PAPER, Head, draw_sheet
from zoomout_core.runtime.progress import portion, stage
from zoomout_core.transfer.rigging.stretch import play_offsets, stretched_edges

from .. import mesh_data
from ..colors import stretched_colors
from ..jobs import run
from ..scene.pair import find_mesh
from ..scene.stored_pair import read_stored_match
from ..storage.stored_match import Match

# Height of letters, relative to that of their line, and their distance from its left and lower border.
LETTERS, INDENT, BASE = 0.75, 0.25, 0.3
# Fraction of the progress for looking for stretched edges.
LOOKING = 0.2


@dataclass(frozen=True, eq=False)
class _Parts:
    """Objects at rest, joined in their order.

    Attributes:
        surface: their meshes, in world space.
        keys: by name, what each key adds at full strength, (n, 3) in world space.
        first: the first vertex of each object, by its name.
    """

    surface: zo.Surface
    keys: dict[str, Floats]
    first: dict[str, int]

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
    """

    sheet: Bytes
    stretched: dict[str, dict[str, int]] = field(default_factory=dict)


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
    marks = {name: np.zeros(len(target.surface.vertices), dtype=bool) for name in source.keys}
    counts: dict[str, dict[str, int]] = {}
    with portion(0, LOOKING), stage("Looking for stretched edges"):
        for name, (first, match) in matches.items():
            others = getattr(match, "others", ())
            own = find_stretched(context, [first, *others], name, match)
            counts[name] = {key: int(found.sum()) for key, found in own.items() if found.any()}
            for key, found in own.items():
                marks[key][target.first[name] :][: len(found)] = found
    with portion(LOOKING, 1):
        return Review(draw_sheet(source.head, target.head, marks, _draw_text), counts)


@dataclass(frozen=True, eq=False)
class Stretched:
    """The faces that the keys of a matched object stretch.

    Attributes:
        sources: names of the objects that it was matched with; none if it has no match.
        vertices: by key, the vertices (n_t,) at edges that stretch much more than on the source; only where there are
            some.
        content: hash of the object's mesh, see `mesh_data.content_hash`.
    """

    sources: tuple[str, ...]
    vertices: dict[str, Booleans]
    content: str

    def colors(self, key: str) -> Floats | None:
        """(n_t, 3) colours of the vertices for a key; None if it stretches nothing."""
        found = self.vertices.get(key)
        return None if found is None else stretched_colors(found)


def stretch_of_keys(context: Context, target: Object) -> Stretched:
    """The faces that an object's keys stretch, along its stored match; none without a valid match."""
    content = mesh_data.content_hash(target.data)
    try:
        pair, match = run(read_stored_match(context, target.name))
    except zo.MeshError:  # no match, or a mesh was edited since
        return Stretched((), {}, content)
    found = find_stretched(context, pair.source_names, target.name, match)
    return Stretched(pair.source_names, {key: each for key, each in found.items() if each.any()}, content)


def names_of_keys(obj: Object) -> list[str]:
    """The names of an object's shape keys besides the Basis."""
    key = obj.data.shape_keys
    return [] if key is None else [block.name for block in key.key_blocks if block != key.reference_key]


def has_keys(context: Context, name: str) -> bool:
    """Whether an object has shape keys besides the Basis."""
    return bool(names_of_keys(find_mesh(context, name)))


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
    surfaces, keys, first, count = [], list[dict[str, Floats]](), dict[str, int](), 0
    for obj in objects:
        at_rest = mesh_data.read_surface_at_rest(obj, positions=mesh_data.read_rest_positions(obj.data))
        surfaces.append(at_rest.with_vertices(mesh_data.positions_in_world(obj, at_rest.vertices)))
        keys.append(_offsets_in_world(obj))
        first[obj.name] = count
        count += len(at_rest.vertices)
    joined = {name: np.zeros((count, 3)) for own in keys for name in own}
    for obj, own in zip(objects, keys, strict=True):
        for name, offsets in own.items():
            joined[name][first[obj.name] :][: len(offsets)] = offsets
    return _Parts(zo.Surface.joined(surfaces), joined, first)


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
