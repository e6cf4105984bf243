# SPDX-License-Identifier: GPL-3.0-or-later
"""A filter that stores eigenfunctions of the Laplacian as attributes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import zoomout_core as zo
from meshlab_filter.catalogue import current_id, mesh_filter
from meshlab_filter.mesh_data import apply_native, read_shape
from meshlab_filter.parameters import COUNT, TEXT, Parameter
from meshlab_filter.stored import check_names
from zoomout_core.runtime.progress import stage

if TYPE_CHECKING:
    from pymeshlab import MeshSet


@mesh_filter(
    Parameter("functions", COUNT, 20, "Number of eigenfunctions, including the constant one."),
    Parameter("show", COUNT, 1, "Number of the eigenfunction to show as vertex quality."),
    Parameter(
        "name",
        TEXT,
        "eigenfunction",
        "Prefix of the custom attributes NAME_0, NAME_1, ... that store the eigenfunctions.",
    ),
    Parameter("seed", COUNT, 0, "Random seed of the eigensolver."),
)
def compute_laplacian_eigenfunctions(ms: MeshSet, *, functions: int, show: int, name: str, seed: int) -> dict[str, Any]:
    """Compute the first eigenfunctions of the current mesh's Laplacian, smooth functions nearly independent of pose.

    A layer without faces is treated as points of a surface.

    Returns:
        `eigenvalues`, an array, of the mesh scaled to unit area.

    Raises:
        MeshError: there is no mesh, it has too few vertices, is collinear, or already has an attribute of that name.
        ValueError: there are fewer functions, or the function to show does not exist.
    """
    mesh_id = current_id(ms)
    shape, mesh = read_shape(ms, mesh_id), ms.mesh(mesh_id)
    if not 1 <= functions < mesh.vertex_number():
        raise ValueError(
            f"'functions' is {functions}: give a whole number below that of the {mesh.vertex_number()} vertices."
        )
    if show >= functions:
        raise ValueError(
            f"'show' is {show}: give a number from 0 to {functions - 1}, since only that many functions are computed."
        )
    names = [f"{name}_{number}" for number in range(functions)]
    check_names(mesh, names)
    with stage("Computing eigenfunctions"):
        basis = zo.eigenbasis(shape, functions, seed)
    for number, attribute in enumerate(names):
        mesh.add_vertex_custom_scalar_attribute(basis.eigenvectors[:, number].astype(float), attribute)
    apply_native(ms, mesh_id, "compute_scalar_by_function_per_vertex", q=names[show])
    return {"eigenvalues": basis.eigenvalues}
