# SPDX-License-Identifier: GPL-3.0-or-later
"""Filters that compute, colour and check correspondences, and deform the target to the source's shape."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

import zoomout_core as zo
from meshlab_filter.catalogue import mesh_filter
from meshlab_filter.filters.match_parameters import ACCURACY, MATCHING, SOURCE, STORED, STORED_OR_NEW, TARGET
from meshlab_filter.filters.matches import find_correspondence, match_layers, report_on
from meshlab_filter.layer import Layer
from meshlab_filter.mesh_data import add_layer, apply_native, attribute_values, check_target, custom_names, read_layer
from meshlab_filter.parameters import LENGTH, TEXT, Parameter, absolute_length
from meshlab_filter.stored import Correspondence, attribute_names, check_names, partner_name, read_stored, store
from zoomout_core.arrays import Floats
from zoomout_core.matching.presets import resolve_detail
from zoomout_core.matching.refinement.confidence import cycle_error
from zoomout_core.mesh.input_checks import vertex_numbers
from zoomout_core.mesh.triangles import vertex_normals
from zoomout_core.runtime.progress import portion, stage

if TYPE_CHECKING:
    from pymeshlab import MeshSet


@mesh_filter(
    SOURCE,
    TARGET,
    Parameter("name", TEXT, "correspondence", "Name to store the correspondence under, for use by other filters."),
    *MATCHING,
)
def compute_correspondence_by_zoomout(
    ms: MeshSet, *, sourcemesh: int, targetmesh: int, name: str, **matching: Any
) -> dict[str, Any]:
    """Compute the corresponding point on the source for every vertex of the target.

    It is stored on the target in the custom attributes NAME_triangle (index of the source's face),
    NAME_barycentric (coordinates in it), NAME_x, NAME_y and NAME_z (the same place in the source's own frame),
    NAME_confidence (in [0, 1]) and NAME_has_partner (1, or 0 without a partner on the source). Nothing else
    changes.

    Returns:
        `triangle`, `barycentric` and `confidence`, arrays; `has_partner` and `source_has_partner`, for both
        meshes' vertices; `share_without_partner` and `source_share_without_partner`, shares of their areas; `verdict`,
        with a `level` (green, amber or red), a `sentence` and `advice`; `certainty`, the probability that
        the map is right as a whole, without swapped sides; `candidates`, each with its origin, whether it reverses
        orientation, and its scores; `parts`, the share of the target that receives from each texture or loose part of
        the source; `notes`, sentences for the user.

    Raises:
        MeshError: a mesh that is missing or cannot be used; the message says what to do.
        ValueError: arguments that do not fit together.
    """
    source, target = read_layer(ms, sourcemesh), read_layer(ms, targetmesh)
    check_names(ms.mesh(targetmesh), [*attribute_names(name), partner_name(name)])
    result = match_layers(source, target, **matching)
    store(ms.mesh(targetmesh), name, Correspondence(result.surface_map, result.confidence, result.has_partner), source)
    report = report_on(result, source)
    return {**report, "triangle": result.surface_map.triangle, "barycentric": result.surface_map.barycentric}


@mesh_filter(SOURCE, TARGET, STORED)
def compute_color_by_correspondence(
    ms: MeshSet, *, sourcemesh: int, targetmesh: int, correspondence: str
) -> dict[str, Any]:
    """Colour both meshes so that corresponding points have the same colour.

    The source's vertices are coloured by their position in its bounding box, x red, y green and z blue, and the
    target's by the position of their corresponding points.

    Returns:
        An empty dictionary.

    Raises:
        MeshError: a mesh is missing or has no faces, or there is no such correspondence.
    """
    source = read_layer(ms, sourcemesh)
    read_layer(ms, targetmesh)
    read_stored(ms.mesh(targetmesh), correspondence, source)
    used = source.vertices[source.surface.triangles.ravel()]
    low, extent = used.min(axis=0), np.ptp(used, axis=0)
    with stage("Colouring"):
        # MeshLab calls red, green and blue "x", "y" and "z" here.
        for mesh_id, prefix in ((sourcemesh, ""), (targetmesh, f"{correspondence}_")):
            colors = {
                axis: f"rint(255*({prefix}{axis}-({float(low[i])!r}))/{float(extent[i]) or 1.0!r})"
                for i, axis in enumerate("xyz")
            }
            apply_native(ms, mesh_id, "compute_color_by_function_per_vertex", **colors, a="255")
    return {}


@mesh_filter(
    SOURCE,
    TARGET,
    STORED,
    Parameter(
        "truth",
        TEXT,
        "",
        "Custom scalar of the target with the ground-truth source vertex of each vertex; if empty, no errors are "
        "computed.",
    ),
    Parameter("selectabove", LENGTH, 0, "Select target vertices with a larger error; 0 keeps the current selection."),
    Parameter("name", TEXT, "correspondence_error", "Custom attribute to store the result in."),
    *ACCURACY,
)
def compute_scalar_by_correspondence_error(
    ms: MeshSet,
    *,
    sourcemesh: int,
    targetmesh: int,
    correspondence: str,
    truth: str,
    selectabove: Any,
    name: str,
    **accuracy: Any,
) -> dict[str, Any]:
    """Write the error of a correspondence at each vertex to the target's quality.

    If the truth is given, the error is the Euclidean distance from it on the source. Otherwise the inverse map is
    computed independently, and the error is the distance of each vertex from its image there and back; errors that
    both maps share are not detected.

    Returns:
        `error`, an array in the unit of the meshes; its `mean`, `median` and `percentile_95`; `notes`.

    Raises:
        MeshError: a mesh is missing or cannot be used, or there is no such correspondence or truth.
        ValueError: the truth does not contain vertex indices.
    """
    source, target = read_layer(ms, sourcemesh), read_layer(ms, targetmesh)
    mesh = ms.mesh(targetmesh)
    found = read_stored(mesh, correspondence, source)
    check_names(mesh, [name])
    if truth:
        true = vertex_numbers(attribute_values(mesh, truth), len(source.vertices), f"The attribute '{truth}'")
        places, notes = source.surface.vertices, list[str]()
        with stage("Comparing with the ground truth"):
            error = np.linalg.norm(found.surface_map.interpolate(places) - places[true], axis=1)
    else:
        error, notes = _there_and_back(source, target, found, **accuracy)
    mesh.add_vertex_custom_scalar_attribute(error, name)
    apply_native(ms, targetmesh, "compute_scalar_by_function_per_vertex", q=name)
    limit = absolute_length(selectabove, target.surface.vertices)
    if limit > 0:
        apply_native(ms, targetmesh, "compute_selection_by_condition_per_vertex", condselect=f"{name} > {limit!r}")
    mean, median, high = float(error.mean()), float(np.median(error)), float(np.percentile(error, 95))
    return {"error": error, "mean": mean, "median": median, "percentile_95": high, "notes": notes}


@mesh_filter(SOURCE, TARGET, STORED_OR_NEW, *MATCHING)
def apply_conform_by_zoomout(
    ms: MeshSet, *, sourcemesh: int, targetmesh: int, correspondence: str, **matching: Any
) -> dict[str, Any]:
    """Deform the target's vertices and faces to the shape of the source.

    The result is a new layer, which becomes current: the target with all its data, deformed onto the source.

    Returns:
        `mesh_id` of the new layer; `confidence`; `candidates` and `certainty`, unless the correspondence was stored;
        `notes`.

    Raises:
        MeshError: a mesh that is missing or cannot be used; the message says what to do.
        ValueError: arguments that do not fit together.
    """
    source, target = read_layer(ms, sourcemesh), read_layer(ms, targetmesh, custom_names(ms, targetmesh))
    check_target(target)
    with portion(0.0, 0.95):
        found, report = find_correspondence(ms, source, target, targetmesh, correspondence, **matching)
    with stage("Bending the target", 0.95):
        vertices = zo.conform(found, source.surface, target.surface)
    new = replace(
        target,
        label=f"{target.label}_conformed",
        vertices=vertices,
        normals=vertex_normals(vertices, target.surface.triangles),
        shape=target.surface.with_vertices(vertices) if len(target.faces) else zo.PointCloud(vertices),
        transform=np.eye(4),
    )
    return {**report, "mesh_id": add_layer(ms, new)}


def _there_and_back(source: Layer, target: Layer, found: Correspondence, **accuracy: Any) -> tuple[Floats, list[str]]:
    """(n_t,) distances of vertices from their images there and back, and notes on the inverse map."""
    # The inverse is evidence, not the start: it distinguishes the sides, and the inverse map is computed independently.
    inverse = found.surface_map.invert(source.surface, target.surface)
    back = zo.match(target.shape, source.shape, initial_map=inverse, **resolve_detail(**accuracy))
    return cycle_error(found.surface_map, back.surface_map, target.surface.vertices), list(back.notes)
