# SPDX-License-Identifier: GPL-3.0-or-later
"""Posed characters whose right side has more vertices than the left, and no weights."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import bpy
import numpy as np
from scipy.sparse import csr_array, diags_array

from blender_addon import mesh_data
from blender_addon.demo.character import select_only
from blender_addon.demo.target import posed_copy, set_pose
from zoomout_core.arrays import Booleans
from zoomout_core.mesh.surface import Surface
from zoomout_core.symmetry.mirror import flip_names
from zoomout_core.transfer import Attribute

from .bodies import Template, build_template, draw_pose
from .kinds import KINDS

# Cells of the template, in metres; cut edges are at least this far to the right, in every second band of this width.
CELL, CUT_BEYOND, BAND = 0.02, -0.15, 0.08
# Tolerance of Blender's mirroring by position, in metres.
RIGHT_OF = -1e-4


@dataclass(frozen=True, eq=False)
class Lopsided:
    """A posed character.

    Attributes:
        surface: in its pose.
        truth: the true weights: at rest the right side's mirror the left side's.
        broken: the same without any on the right side.
        by_topology: the weights after Blender's own mirroring by topology.
        by_position: the same by positions.
        right: (n,) which vertices belong to the right side.
    """

    surface: Surface
    truth: Attribute
    broken: Attribute
    by_topology: Attribute
    by_position: Attribute
    right: Booleans


def lopsided_characters(count: int, seed: int, kind: str = "biped") -> Iterator[Lopsided]:
    """A number of characters in random poses, which face -y."""
    random = np.random.default_rng(seed)
    for _ in range(count):
        template = build_template(KINDS[kind], CELL)
        weights = _true_weights(template)
        mesh_data.write_weights(template.body, weights)
        _cut_right_side(template.body)
        rest = mesh_data.read_positions(template.body.data)
        truth = mesh_data.read_weights(template.body, template.body.data)
        right = rest[:, 0] < RIGHT_OF
        broken = replace(truth, values=csr_array(diags_array((~right).astype(float)) @ truth.values))
        pose = draw_pose(template.kind, random)
        set_pose(template.armature, {name: turn for name, turn in pose.items() if name != "hips"})
        posed = posed_copy(template.body)
        surface = mesh_data.read_target_surface(posed, bpy.context.evaluated_depsgraph_get())
        yield Lopsided(
            Surface(surface.vertices, surface.triangles),
            truth,
            broken,
            _mirrored_by_blender(posed, broken, right, topology=True),
            _mirrored_by_blender(posed, broken, right, topology=False),
            right,
        )


def _true_weights(template: Template) -> Attribute:
    """The template's automatic weights, with the left side's mirrored to the right."""
    weights = mesh_data.read_weights(template.body, template.body.data)
    triangle, barycentric = template.mirror
    n = len(template.surface.vertices)
    columns = template.surface.triangles[triangle].ravel()
    to_mirror_image = csr_array((barycentric.ravel(), columns, np.arange(0, 3 * n + 1, 3)), shape=(n, n))
    other = csr_array(to_mirror_image @ flip_names(weights).values)
    right = (template.surface.vertices[:, 0] < 0).astype(float)
    values = diags_array(1 - right) @ weights.values + diags_array(right) @ other
    return replace(weights, values=csr_array(values))


def _cut_right_side(body: bpy.types.Object) -> None:
    """Subdivide the edges in bands of the right side; weights are interpolated."""
    import bmesh  # exists only after `bpy` is imported

    mesh = bmesh.new()
    mesh.from_mesh(body.data)
    cut = []
    for edge in mesh.edges:
        middle = (edge.verts[0].co + edge.verts[1].co) / 2
        along = middle.x if abs(middle.x) > 0.3 else middle.z
        if middle.x < 0 and (middle.x < CUT_BEYOND or middle.z < 0.8) and int(abs(along) / BAND) % 2 == 0:
            cut.append(edge)
    bmesh.ops.subdivide_edges(mesh, edges=cut, cuts=1, use_grid_fill=True)
    bmesh.ops.triangulate(mesh, faces=mesh.faces[:])
    mesh.to_mesh(body.data)
    mesh.free()


def _mirrored_by_blender(body: bpy.types.Object, weights: Attribute, right: Booleans, topology: bool) -> Attribute:
    """The weights after Blender's `Mirror Vertex Group` with the right side selected."""
    mesh_data.write_weights(body, weights)
    mesh = body.data
    select_only(body)
    mesh.polygons.foreach_set("select", np.zeros(len(mesh.polygons), dtype=bool))
    mesh.edges.foreach_set("select", np.zeros(len(mesh.edges), dtype=bool))
    mesh.vertices.foreach_set("select", right)
    mesh.use_paint_mask_vertex = True
    bpy.ops.object.mode_set(mode="WEIGHT_PAINT")
    bpy.ops.object.vertex_group_mirror(all_groups=True, use_topology=topology)
    bpy.ops.object.mode_set(mode="OBJECT")
    return mesh_data.read_weights(body, mesh)
