# SPDX-License-Identifier: GPL-3.0-or-later
"""Find twelve landmarks of a head by its expression keys.

The key that opens the jaw separates the lips, and a blink closes the gap between the eyelids. Both are slits, whose
corners are halfway around their ends. The eyes and the mouth determine the directions left, up and forward. The other
landmarks are extreme points in these directions, as in anthropometry.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers, row_norms
from zoomout_core.geometry.procrustes import SMALLEST
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.shapes import ShapeLike, as_placed_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import edge_graph, vertex_areas
from zoomout_core.mesh.working_mesh import WorkingMesh
from zoomout_core.transfer.attribute import Attribute, Kind
from zoomout_core.transfer.frames import on_working_mesh
from zoomout_core.transfer.keys.head_directions import HeadDirections
from zoomout_core.transfer.keys.key_names import translate_key_names

# The names of the landmarks, in their order.
FACE_LANDMARKS = (
    "Left Mouth Corner",
    "Right Mouth Corner",
    "Upper Lip",
    "Lower Lip",
    "Left Eye Outer Corner",
    "Left Eye Inner Corner",
    "Right Eye Outer Corner",
    "Right Eye Inner Corner",
    "Nose",
    "Chin",
    "Left Ear",
    "Right Ear",
)
# Expressions that are needed, each with the keys of the conventions that make it.
BLINK_LEFT, BLINK_RIGHT, OPEN_MOUTH = "left", "right", "mouth"
KEYS = {
    BLINK_LEFT: (("arkit", "eyeBlinkLeft"),),
    BLINK_RIGHT: (("arkit", "eyeBlinkRight"),),
    OPEN_MOUTH: (("arkit", "jawOpen"), ("oculus", "viseme_aa")),
}
NOTHING_OPENS = {
    BLINK_LEFT: "No lids meet in the blink of the left eye: place landmarks by hand.",
    BLINK_RIGHT: "No lids meet in the blink of the right eye: place landmarks by hand.",
    OPEN_MOUTH: "The key that opens the mouth does not part any lips: place landmarks by hand.",
}

# Lengths relative to the distance between the eyes, about 65 mm.
TOUCHING = 0.08  # largest gap of a closed slit: coarse lips, and lids that do not close fully
THICKNESS = 0.08  # of lips and lids: a surface farther behind the visible skin is in the mouth or in a socket
BESIDE_LIP = 0.05  # largest distance of the middle of the lips from the plane between left and right
BESIDE = 0.15  # the same for nose and chin
LIP = 0.15  # height of a lip
AROUND_MOUTH = 1.0  # from the mouth to the chin, but not to the chest
AROUND_EYES = 2.6  # from the eyes to the ears, but not to the shoulders
# Along a slit, its sides move apart by at least this share of their largest separation. This includes the ends of the
# slit, but excludes stretched skin.
OPENING = 0.15
# The distance between them also grows at least by this factor.
STRETCH = 3.0


class Slit(NamedTuple):
    """Pairs of vertices (p,) that meet when a slit is closed."""

    upper: Integers
    lower: Integers


@dataclass(frozen=True, eq=False)
class FaceSkin:
    """The skin of a head with n vertices, and the directions of the head as unit vectors."""

    vertices: Floats  # (n, 3)
    normals: Floats  # (n, 3) outward unit normals
    graph: csr_array  # (n, n) its edges with their lengths
    left: Floats  # (3,)
    up: Floats  # (3,)
    forward: Floats  # (3,)
    eyes: Floats  # (3,) the point between the eyes
    size: float  # the distance between the eyes

    def find_slit(self, closed: Floats, opened: Floats) -> Slit:
        """Pairs of vertices that touch in one shape (n, 3) of the skin and are apart in another one."""
        visible = np.flatnonzero(self.visible)
        pairs = visible[cKDTree(closed[visible]).query_pairs(TOUCHING * self.size, output_type="ndarray")]
        near, far = (row_norms(shape[pairs[:, 0]] - shape[pairs[:, 1]]) for shape in (closed, opened))
        pairs = pairs[are_parted(near, far, float((far - near).max(initial=0)))]
        above = np.einsum("px,x->p", opened[pairs[:, 0]] - opened[pairs[:, 1]], self.up) > 0
        return Slit(*np.where(above[:, None], pairs, pairs[:, ::-1]).T)

    @cached_property
    def visible(self) -> Booleans:
        """A mask (n,) of the vertices that face forward and are not hidden by a surface in front of them."""
        plane = np.column_stack([self.vertices @ self.left, self.vertices @ self.up])
        depth, facing = self.vertices @ self.forward, self.normals @ self.forward > 0
        radius = THICKNESS * self.size / 2
        around = cKDTree(plane).query_ball_point(plane[facing], radius)
        front = np.array([depth[near].max() for near in around])
        visible = facing.copy()
        visible[facing] = depth[facing] > front - THICKNESS * self.size
        return visible

    def find_corner(self, slit: Slit, side: Floats) -> int:
        """The vertex halfway around that end of a slit which is farthest in a direction (3,)."""
        last = int(np.argmax((self.vertices[slit.upper] + self.vertices[slit.lower]) @ side))
        distances = dijkstra(self.graph, indices=[slit.upper[last], slit.lower[last]])
        around = distances.sum(axis=0)
        shortest = around <= (1 + 1e-9) * around.min()  # up to rounding
        return int(np.argmin(np.where(shortest, distances.max(axis=0), np.inf)))

    def farthest(self, direction: Floats, chosen: Booleans) -> int:
        """The vertex that is farthest in a direction (3,), among those chosen (n,)."""
        return int(np.argmax(np.where(chosen, self.vertices @ direction, -np.inf)))

    def is_near(self, place: Floats, distance: float) -> Booleans:
        """A mask (n,) of the vertices within a distance of a point (3,), in distances between the eyes."""
        return np.asarray(row_norms(self.vertices - place) < distance * self.size)


class FaceSlits(NamedTuple):
    """The skin of a head with its slits, one for each expression of `KEYS`."""

    skin: FaceSkin
    slits: dict[str, Slit]  # empty ones if an expression does not open or close anything
    vertices: Integers  # (n,) the surface's vertices of the skin


def propose_face_landmarks(surface: ShapeLike, keys: Attribute) -> dict[str, int]:
    """Find the landmarks of a head by its expression keys.

    Args:
        surface: a head, alone or on a body.
        keys: its shape keys, of the kind OFFSET, with names of a known convention. A blink of each eye and a key that
            opens the mouth are required.

    Returns:
        A vertex of the surface for each name in `FACE_LANDMARKS`.

    Raises:
        MeshError: a required key is missing, or does not open or close anything.
        TypeError: these are no keys of the surface.

    Example:
        >>> values = np.zeros((len(source.vertices), 1, 3))
        >>> zo.propose_face_landmarks(source, zo.Attribute("keys", zo.Domain.POINT, zo.Kind.OFFSET, values, ("smile",)))
        Traceback (most recent call last):
        zoomout_core.mesh.errors.MeshError: There is no shape key eyeBlinkLeft: add one, or place landmarks by hand.
    """
    surface = as_placed_surface(surface)
    _check_keys(keys, len(surface.vertices))
    skin, slits, own = find_slits(surface, keys)
    rest = skin.vertices
    for use, slit in slits.items():
        if not len(slit.upper):
            raise MeshError(NOTHING_OPENS[use])
    left, right, mouth = slits.values()
    vertices = (
        skin.find_corner(mouth, skin.left),
        skin.find_corner(mouth, -skin.left),
        *_lips(skin, mouth),
        skin.find_corner(left, skin.left),
        skin.find_corner(left, -skin.left),
        skin.find_corner(right, -skin.left),
        skin.find_corner(right, skin.left),
        *_extremes(skin, rest[np.concatenate(mouth)].mean(axis=0)),
    )
    return dict(zip(FACE_LANDMARKS, own[list(vertices)].tolist(), strict=True))


def _check_keys(keys: object, count: int) -> None:
    """Raise a TypeError unless a user's keys have offsets of each of `count` vertices."""
    if not (
        isinstance(keys, Attribute)
        and keys.kind is Kind.OFFSET
        and np.shape(keys.values) == (count, len(keys.labels), 3)
    ):
        raise TypeError(f"The keys must be an Attribute of the kind OFFSET, with values ({count}, keys, 3) and labels.")


def find_slits(surface: Surface, keys: Attribute) -> FaceSlits:
    """The skin of a head, and the slits that its keys open or close.

    Raises:
        MeshError: the keys lack an expression.
    """
    offsets = {use: find_offsets(keys, names) for use, names in KEYS.items()}
    motion = sum(row_norms(each) for each in offsets.values()) * surface.vertex_areas
    moving = int(np.argmax(np.bincount(np.maximum(surface.components, 0), motion)))
    mesh, _ = surface.working.part(moving)
    found = {use: on_working_mesh(mesh, each) / mesh.scale for use, each in offsets.items()}
    skin = _skin_of(mesh, found)
    rest = skin.vertices
    slits = {
        BLINK_LEFT: skin.find_slit(rest + found[BLINK_LEFT], rest),
        BLINK_RIGHT: skin.find_slit(rest + found[BLINK_RIGHT], rest),
        OPEN_MOUTH: skin.find_slit(rest, rest + found[OPEN_MOUTH]),
    }
    return FaceSlits(skin, slits, on_working_mesh(mesh, np.arange(len(surface.vertices))))


def are_parted(near: Floats, far: Floats, most: float) -> Booleans:
    """A mask (p,) of pairs across a slit, by their distances (p,) in its closed and in its opened shape.

    `most` is the largest increase of a distance.
    """
    return np.asarray((far - near > OPENING * most) & (far > STRETCH * near))


def find_expressions(keys: Attribute) -> list[Floats] | None:
    """Offsets (n, 3) of the vertices by each expression of `KEYS`; None if the keys lack one of them."""
    try:
        return [find_offsets(keys, names) for names in KEYS.values()]
    except MeshError:
        return None


def find_offsets(keys: Attribute, names: Sequence[tuple[str, str]]) -> Floats:
    """Offsets (n, 3) of the first key that exists among some, each given by its convention and name."""
    parts = find_keys(keys, names)
    if not parts:
        raise MeshError("There is no shape key {name}: add one, or place landmarks by hand.", name=names[0][1])
    offsets = np.asarray(keys.values, dtype=np.float64)
    return np.asarray(offsets[:, [keys.labels.index(part) for part in parts]].sum(axis=1))


def find_keys(keys: Attribute, names: Sequence[tuple[str, str]]) -> tuple[str, ...]:
    """The keys whose sum is the first expression that exists among some, each given by its convention and name.

    Empty if all are missing.
    """
    for convention, name in names:
        translated = translate_key_names(keys.labels, convention)
        parts = tuple(old for old, new in translated.renamed.items() if new == name) or translated.composed.get(name)
        if parts:
            return tuple(parts)
    return ()


def _skin_of(mesh: WorkingMesh, offsets: Mapping[str, Floats]) -> FaceSkin:
    """The skin, with the directions of the head computed from the regions that keys (n, 3) move."""
    vertices = mesh.vertices
    areas = vertex_areas(vertices, mesh.triangles)

    def middle(use: str) -> Floats:
        weight = areas * row_norms(offsets[use])
        return np.asarray(weight @ vertices / max(float(weight.sum()), SMALLEST))

    one, other, mouth = (middle(use) for use in (BLINK_LEFT, BLINK_RIGHT, OPEN_MOUTH))
    head = HeadDirections.of(one, other, mouth)
    graph = edge_graph(vertices, mesh.triangles)
    eyes = (one + other) / 2
    return FaceSkin(vertices, mesh.vertex_normals, graph, head.left, head.up, head.forward, eyes, head.size)


def _lips(skin: FaceSkin, mouth: Slit) -> tuple[int, int]:
    """The foremost vertices of the upper and of the lower lip, in the middle."""
    height, beside = skin.vertices @ skin.up, np.abs((skin.vertices - skin.eyes) @ skin.left)
    chosen = []
    for rim, upwards in ((mouth.upper, 1), (mouth.lower, -1)):
        middle = rim[np.argmin(beside[rim])]
        above = upwards * (height - height[middle])
        lip = (above >= 0) & (above < LIP * skin.size) & skin.is_near(skin.vertices[middle], 2 * LIP)
        lip &= beside <= beside[lip].min() + BESIDE_LIP * skin.size
        chosen.append(skin.farthest(skin.forward, lip))
    return chosen[0], chosen[1]


def _extremes(skin: FaceSkin, mouth: Floats) -> tuple[int, int, int, int]:
    """Nose, chin and ears, from the position of the mouth."""
    middle = np.abs((skin.vertices - skin.eyes) @ skin.left) < BESIDE * skin.size
    height = skin.vertices @ skin.up
    nose = middle & (height > mouth @ skin.up) & (height < skin.eyes @ skin.up)
    below = middle & (height < mouth @ skin.up) & skin.is_near(mouth, AROUND_MOUTH)
    head = skin.is_near(skin.eyes, AROUND_EYES)
    return (
        skin.farthest(skin.forward, nose),
        skin.farthest(skin.forward - skin.up, below),
        skin.farthest(skin.left, head),
        skin.farthest(-skin.left, head),
    )
