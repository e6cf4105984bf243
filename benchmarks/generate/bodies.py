# SPDX-License-Identifier: GPL-3.0-or-later
"""Characters in Blender: a kind's template, individuals of it, and their meshes in poses.

All individuals of a kind are one template, thickened and lengthened bone by bone, slightly dented, and posed by its
armature; so a vertex of the template corresponds to the same place on all of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import bpy
import numpy as np
import trimesh
from scipy.spatial import cKDTree

from blender_addon import mesh_data
from blender_addon.demo.character import rig
from blender_addon.demo.target import posed_copy, rebuilt, set_pose
from zoomout_core.arrays import Floats, Integers
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import unique_edges, vertex_normals
from zoomout_core.samples.implicit import bounds, surface_net

from .folder import standing_for
from .kinds import Build, Kind
from .remeshing import REMESHINGS

# Edge length of the template, and voxel size for remeshing posed bodies, in metres.
CELL, VOXEL = 0.016, 0.011
FEWEST_VERTICES, MOST_VERTICES = 4000, 8000
# Depth and width of dents in metres, and number of waves.
DENT, DENT_WIDTH, WAVES = 0.006, 0.25, 12
# Distance of clothes from the skin, in metres.
OFFSET = 0.014
# Minimum share of the template that must be found on a mesh: fused limbs hide some of it.
FOUND = 0.97
# Maximum number of poses to try for one mesh.
TRIES = 60
# Number of vertices around a loose part whose motion it follows.
CARRIERS = 100


class GenerationError(RuntimeError):
    """No valid mesh was generated; the message says what to do."""


@dataclass(frozen=True, eq=False)
class Template:
    """The common shape of a kind, in Blender's scene.

    Attributes:
        kind: the kind of character.
        body: the mesh object.
        armature: deforms the body.
        surface: its surface at rest.
        mirror: for each vertex the triangle and the barycentric coordinates of its mirror image.
        garments: for each garment the triangles that it covers.
    """

    kind: Kind
    body: bpy.types.Object
    armature: bpy.types.Object
    surface: Surface
    mirror: tuple[Integers, Floats]
    garments: list[Integers]


@dataclass(frozen=True, eq=False)
class Individual:
    """The differences of one character from its template.

    Attributes:
        traits: (t,) logarithms of the factors of all traits.
        scale: the factors across and along each bone.
        rest: (n, 3) the template's vertices with dents, before scaling and posing.
        dressed: whether it wears clothes.
    """

    traits: Floats
    scale: Mapping[str, tuple[float, float]]
    rest: Floats
    dressed: bool


@dataclass(frozen=True, eq=False)
class PosedMesh:
    """A character to be written.

    Attributes:
        surface: its body, remeshed, and its loose parts.
        places: (n,) the surface vertex at each vertex of the template, -1 for none.
        mirrored: (n,) the surface vertex at the mirror image of each vertex of the template.
        refused: number of poses drawn before this one in which limbs touched, so that the body was not closed.
    """

    surface: Surface
    places: Integers
    mirrored: Integers
    refused: int


def build_template(kind: Kind, cell: float = CELL) -> Template:
    """A kind's template in Blender's current session, which is emptied first."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    surface = Surface(*surface_net(cell, kind.solids, bounds(kind.solids, 5 * cell)))
    mesh = bpy.data.meshes.new("Template")
    mesh.from_pydata(surface.vertices, [], surface.triangles)
    body = bpy.data.objects.new("Template", mesh)
    bpy.context.scene.collection.objects.link(body)
    armature = rig(body, kind.bones)
    for bone in armature.data.bones:
        bone.inherit_scale = "NONE"
    weights = mesh_data.read_weights(body, mesh)
    garments = []
    for covered in kind.dress:
        columns = [i for i, name in enumerate(weights.labels) if name.startswith(covered)]
        inside = weights.values[:, columns].sum(axis=1) > 0.5
        garments.append(surface.triangles[inside[surface.triangles].all(axis=1)])
    mirror = closest_points(surface.vertices * (-1, 1, 1), surface.vertices, surface.triangles)
    return Template(kind, body, armature, surface, mirror, garments)


def draw_individual(template: Template, random: np.random.Generator, exaggeration: float, dressed: bool) -> Individual:
    """An individual with random proportions: all factors are raised to the power of the exaggeration."""
    traits, scale = [], {}
    for build in template.kind.builds:
        thickness, length = _drawn(build, random) * exaggeration
        traits += [thickness, length]
        for row in template.kind.bones:
            if row.name.startswith(build.bones):
                scale[row.name] = float(np.exp(thickness)), float(np.exp(length))
    surface = template.surface
    normals = vertex_normals(surface.vertices, surface.triangles)
    rest = surface.vertices + _dents(surface.vertices, random)[:, None] * normals
    return Individual(np.array(traits), scale, rest, dressed)


def posed_mesh(template: Template, individual: Individual, random: np.random.Generator) -> PosedMesh:
    """An individual in a random pose, remeshed with 4,000 to 8,000 vertices, possibly with loose parts.

    Raises:
        GenerationError: none of the poses tried gave one closed body.
    """
    kind, triangles = template.kind, template.surface.triangles
    remeshing = REMESHINGS[str(random.choice(sorted(REMESHINGS)))]
    vertices = int(random.integers(FEWEST_VERTICES, MOST_VERTICES))
    for refused in range(TRIES):
        posed, dense = _struck(template, individual, draw_pose(kind, random))
        body = remeshing(dense, vertices, random)
        if not (is_ball(dense) and is_ball(body)):
            continue
        normals = vertex_normals(posed, triangles)
        places = standing_for(posed, normals, body)
        if (places >= 0).mean() < FOUND:
            continue
        mirrored = standing_for(_mirrored(template, posed), _mirrored(template, normals), body)
        sheets = template.garments if individual.dressed else []
        garments = [_sheet(posed + OFFSET * normals, sheet) for sheet in sheets]
        share = len(body.vertices) / body.area
        loose = [remeshing(garment, int(share * garment.area), random) for garment in garments]
        return PosedMesh(Surface.joined([body, *_eyes(template, posed), *loose]), places, mirrored, refused)
    raise GenerationError(
        f"Limbs touch in each of {TRIES} poses, so that none came out as one closed body: let bones reach less far."
    )


def draw_pose(kind: Kind, random: np.random.Generator) -> dict[str, tuple[float, float, float]]:
    """Angles in degrees for each bone, within its reach; left and right are drawn independently."""
    pose = {}
    for row in kind.bones:
        reach = kind.reach.get(row.name.replace(".R", ".L"))
        if reach is not None:
            x, y, z = (random.uniform(*bounds) for bounds in reach)
            pose[row.name] = (x, -y, -z) if row.name.endswith(".R") else (x, y, z)
    return pose


def is_ball(surface: Surface) -> bool:
    """Whether a surface is closed, manifold, connected and without handles."""
    edges, edge = unique_edges(surface.triangles)
    euler_characteristic = len(np.unique(surface.triangles)) - len(edges) + len(surface.triangles)
    closed = bool((np.bincount(edge.ravel()) == 2).all())
    return closed and surface.components.max() == 0 and euler_characteristic == 2


def _mirrored(template: Template, values: Floats) -> Floats:
    """Values at the mirror images of the template's vertices, given those at the vertices (n, 3)."""
    triangle, barycentric = template.mirror
    return np.einsum("nc,ncx->nx", barycentric, values[template.surface.triangles[triangle]])


def _drawn(build: Build, random: np.random.Generator) -> Floats:
    """Draw logarithms of the factors across and along the bones."""
    low, high = np.log([build.thickness, build.length or build.thickness]).T
    share = random.uniform(size=2) if build.length else random.uniform()
    return low + share * (high - low)


def _dents(points: Floats, random: np.random.Generator) -> Floats:
    """(n,) smooth random heights, of about DENT."""
    waves = random.normal(size=(3, WAVES)) / DENT_WIDTH
    phases = random.uniform(0, 2 * np.pi, WAVES)
    return DENT * np.sqrt(2 / WAVES) * np.cos(2 * np.pi * points @ waves / np.sqrt(3) + phases).sum(axis=1)


def _struck(
    template: Template, individual: Individual, pose: Mapping[str, tuple[float, float, float]]
) -> tuple[Floats, Surface]:
    """The template's vertices (n, 3) in a pose, and the surface that they span, remeshed."""
    mesh = template.body.data
    mesh.vertices.foreach_set("co", individual.rest.ravel().astype(np.float32))
    mesh.update()
    set_pose(template.armature, pose)
    for name, (across, along) in individual.scale.items():
        template.armature.pose.bones[name].scale = (across, along, across)
    bpy.context.view_layer.update()
    posed = posed_copy(template.body)
    dense = rebuilt(posed, VOXEL)
    positions = mesh_data.read_positions(posed.data).astype(float)
    surface = mesh_data.read_target_surface(dense, bpy.context.evaluated_depsgraph_get())
    bpy.data.meshes.remove(posed.data)
    bpy.data.meshes.remove(dense.data)
    return positions, Surface(surface.vertices, surface.triangles)


def _eyes(template: Template, posed: Floats) -> list[Surface]:
    """Eyeballs that move with the flesh around them."""
    left = template.kind.eye
    if left is None:
        return []
    rest = template.surface.vertices
    tree, ball = cKDTree(rest), trimesh.creation.icosphere(subdivisions=2)
    eyes = []
    for eye in (left, left.mirrored()):
        around = tree.query(eye.centre, CARRIERS)[1]
        motion = np.linalg.lstsq(np.insert(rest[around], 3, 1, axis=1), posed[around], rcond=None)[0]
        points = ball.vertices * eye.radii + eye.centre
        eyes.append(Surface(np.insert(points, 3, 1, axis=1) @ motion, ball.faces))
    return eyes


def _sheet(points: Floats, triangles: Integers) -> Surface:
    """The surface of some triangles, without unused vertices."""
    used, faces = np.unique(triangles, return_inverse=True)
    return Surface(points[used], faces.reshape(triangles.shape))
