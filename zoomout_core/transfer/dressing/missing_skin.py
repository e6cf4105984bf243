# SPDX-License-Identifier: GPL-3.0-or-later
"""Clothes over missing skin: avatars often have skin only where their clothes show it, such as a head and hands.

Cloth has skin below it if a straight line from it to the bone that moves it meets skin, or other cloth that is a layer
below it. These lines are followed by sphere tracing (Hart, Sphere tracing: a geometric method for the antialiased ray
tracing of implicit surfaces, 1996). Cloth without skin stands in for the skin of the body. The bones of another avatar
place it there, because a map of such a body to skin would press loose cloth onto the limbs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, vstack
from scipy.spatial import cKDTree

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.geometry.oriented_closest_points import surface_samples
from zoomout_core.geometry.procrustes import SMALLEST
from zoomout_core.geometry.screened_smoothing import ScreenedSmoothing
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import triangle_areas
from zoomout_core.transfer.dressing.form import Form
from zoomout_core.transfer.rigging.bone_pairs import Skeleton
from zoomout_core.transfer.rigging.bone_tree import next_above
from zoomout_core.transfer.rigging.humanoid import humanoid_bones
from zoomout_core.transfer.rigging.joint_map import RiggedBody, SharedJoints
from zoomout_core.transfer.rigging.skinning import renumber_bones, strongest

# Share of the clothes that must lack skin. Bodies are open at eyes and mouths, and hems hang below feet.
MIN_SHARE = 0.1
# Number of samples of skin and cloth. A line meets a surface within the distance of neighbouring samples.
SAMPLES = 40_000
# Lines that run along a surface are given up after this number of steps.
STEPS = 64
# Thinner parts, by their share of the area of skin and cloth, are details on clothes, such as buttons.
MIN_PART = 0.01
# Depth of the skin below the cloth that stands in for it, at unit area: 4 mm on an adult. Contact needs a distance.
DEPTH = 0.003
# Distance from the other skin, at unit area, at which cloth moved by bones adapts half as much to its girth: loose
# cloth such as a skirt keeps its form. And the length over which the girth is averaged.
NEAR, SMOOTH = 0.06, 0.05


PLACED_BY_BONES = (
    "On the avatar that wears them, {share:.0%} of the clothes have no skin below them: the bones of both avatars "
    "placed these."
)
PLACED_BY_SHAPE = (
    "On the avatar that wears them, {share:.0%} of the clothes have no skin below them, and the two avatars have "
    "too few bones in common: these clothes were fitted as if they were skin."
)


class ClothedBody(NamedTuple):
    """A body whose missing skin is replaced by the cloth over it."""

    body: RiggedBody  # the skin, followed by this cloth, which only humanoid bones move
    skin: int  # number of vertices of the skin
    share: float  # share of the area of the clothes that has no skin below it


class PlacedBody(NamedTuple):
    """A clothed body in the shape of another one."""

    cloth: Floats  # (n, 3) its vertices, with cloth at its distance from the other body
    skin: Floats  # (n, 3) its vertices, all on the skin of the other body


def complete_body(
    body: RiggedBody, worn: Sequence[Surface], weights: Sequence[csr_array], depth: float = DEPTH
) -> ClothedBody | None:
    """Complete the skin of a body by the clothes that have no skin below them.

    Args:
        body: the body, with its bones.
        worn: its clothes, without hair.
        weights: for each (n, b) its weights of the same bones.
        depth: depth of the added skin below them, at unit area.

    Returns:
        None if nearly all clothes have skin below them, or the bones are not those of a known humanoid rig.
    """
    bones, parents = _humanoid(body.bones)
    if not len(bones) or not worn:
        return None
    cloth, count = Surface.joined(worn), len(body.bones.names)
    shares = renumber_bones(csr_array(vstack(weights, format="csr")), next_above(body.bones.parents, bones), len(bones))
    bone = np.where(np.asarray(shares.sum(axis=1)).ravel() > 0, strongest(shares), -1)
    inner = _nearest_on_bones(cloth.vertices, bone, body.bones.heads[bones], parents)
    bare = (bone >= 0) & ~_covers(body.surface, cloth, inner)
    areas = triangle_areas(cloth.vertices, cloth.triangles)
    standing_in = cloth.triangles[bare[cloth.triangles].all(axis=1)]
    share = float(triangle_areas(cloth.vertices, standing_in).sum() / max(areas.sum(), SMALLEST))
    if share < MIN_SHARE:
        return None
    used, triangles = np.unique(standing_in, return_inverse=True)
    skin, unit = len(body.surface.vertices), float(np.sqrt(body.surface.area + areas.sum()))
    surface = Surface(
        np.concatenate([body.surface.vertices, _inset(cloth.vertices[used], inner[used], depth * unit)]),
        np.concatenate([body.surface.triangles, triangles.reshape(-1, 3) + skin]),
    )
    of_cloth = renumber_bones(csr_array(shares[used]), bones, count)
    completed = RiggedBody(surface, body.bones, csr_array(vstack([body.weights, of_cloth], format="csr")))
    return ClothedBody(completed, skin, share)


def place_by_bones(clothed: ClothedBody, shape: Floats, target: RiggedBody) -> PlacedBody | None:
    """Place the cloth that stands in for the skin of a body by the bones of another one.

    It stretches along bones, and adapts smoothly to the girth of limbs where it is close to them.

    Args:
        clothed: the body.
        shape: (n, 3) its vertices in the shape of the other body.
        target: the other body.

    Returns:
        None if the bodies have too few humanoid bones in common.
    """
    joints = SharedJoints.of(clothed.body, target)
    if joints is None:
        return None
    is_moved = (np.arange(len(shape)) >= clothed.skin) & (joints.source.bone >= 0)
    moved = np.where(is_moved[:, None], joints.stretch_source(), shape)
    projected = np.where(is_moved[:, None], joints.project_source(moved), shape)
    unit = float(np.sqrt(target.surface.area))
    form = Form.of(clothed.body.surface.with_vertices(moved), unit)
    off = ((shape - moved) / unit)[form.first]
    near = 1 / (1 + (off**2).sum(axis=1, keepdims=True) / NEAR**2)
    adapted = ScreenedSmoothing.of(form.areas, form.stiffness, SMOOTH).smooth(near * off)
    is_moved &= form.number >= 0
    return PlacedBody(moved + unit * np.where(is_moved[:, None], adapted[form.number], 0.0), projected)


def without_missing_limbs(clothed: ClothedBody, has_skin: Booleans) -> Booleans:
    """(n,) the vertices of a clothed body, without the cloth of limbs that have no skin on another body.

    The nearest skin of that body is on another limb, and with its weights trousers would not follow the legs.

    Args:
        clothed: the body.
        has_skin: (b,) whether the partners of its bones move skin of the other body.
    """
    kept = has_skin[strongest(clothed.body.weights)]
    kept[: clothed.skin] = True
    return kept


def _humanoid(bones: Skeleton) -> tuple[Integers, Integers]:
    """(h,) the humanoid bones of a skeleton, and (h,) the nearest one above each, numbered among these; -1 for none."""
    names = humanoid_bones(bones.names) if bones.humanoid is None else bones.humanoid
    chosen = np.flatnonzero(np.isin(bones.names, list(names.values())))
    return chosen, next_above(bones.parents, chosen, strictly=True)[chosen]


def _nearest_on_bones(places: Floats, bone: Integers, heads: Floats, parents: Integers) -> Floats:
    """(n, 3) the nearest points on the bones that move places (n, 3): lines from their heads (h, 3) to those below."""
    nearest = heads[bone]
    distance = np.linalg.norm(places - nearest, axis=1)
    for child in np.flatnonzero(parents >= 0):
        start = heads[parents[child]]
        arm, moved = heads[child] - start, np.flatnonzero(bone == parents[child])
        at = np.clip((places[moved] - start) @ arm / max(arm @ arm, SMALLEST), 0, 1)
        points = start + at[:, None] * arm
        found = np.linalg.norm(places[moved] - points, axis=1)
        closer = found < distance[moved]
        nearest[moved[closer]], distance[moved[closer]] = points[closer], found[closer]
    return nearest


def _covers(skin: Surface, cloth: Surface, inner: Floats) -> Booleans:
    """(n,) whether skin, or another part of the clothes, is between each vertex of the clothes and a place (n, 3)."""
    triangles = np.concatenate([skin.triangles, cloth.triangles + len(skin.vertices)])
    vertices = np.concatenate([skin.vertices, cloth.vertices])
    samples, triangle = surface_samples(vertices, triangles, SAMPLES)
    area = skin.area + cloth.area
    reach = float(np.sqrt(area / SAMPLES))
    number = cloth.working.vertex_of
    component = np.where(number >= 0, cloth.working.component[number], -1)
    part = np.concatenate([np.full(len(skin.triangles), -1), component[cloth.triangles[:, 0]]])
    large = np.bincount(component[cloth.triangles[:, 0]], triangle_areas(cloth.vertices, cloth.triangles))
    found = np.ones(len(cloth.vertices), dtype=bool)
    for own in np.flatnonzero(large >= MIN_PART * area):
        mine, others = np.flatnonzero(component == own), samples[part[triangle] != own]
        found[mine] = _meets(cloth.vertices[mine], inner[mine], cKDTree(others), reach) if len(others) else False
    return found


def _meets(starts: Floats, ends: Floats, points: cKDTree, reach: float) -> Booleans:
    """(n,) whether lines from starts (n, 3) to ends (n, 3) come within reach of some points."""
    offset = ends - starts
    length = np.linalg.norm(offset, axis=1)
    direction = offset / np.maximum(length, SMALLEST)[:, None]
    at, met, going = np.zeros(len(starts)), np.zeros(len(starts), dtype=bool), np.arange(len(starts))
    for _ in range(STEPS):
        if not len(going):
            break
        clear = np.asarray(points.query(starts[going] + at[going, None] * direction[going])[0])
        met[going] = clear < reach
        at[going] += clear
        going = going[(clear >= reach) & (at[going] < length[going])]
    return met


def _inset(places: Floats, inner: Floats, depth: float) -> Floats:
    """(n, 3) places (n, 3) moved by a depth towards others (n, 3), by half of the way at most."""
    offset = inner - places
    length = np.linalg.norm(offset, axis=1, keepdims=True)
    return np.asarray(places + offset * np.minimum(depth / np.maximum(length, SMALLEST), 0.5))
