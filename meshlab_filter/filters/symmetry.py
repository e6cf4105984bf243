# SPDX-License-Identifier: GPL-3.0-or-later
"""A filter that detects the symmetry of a mesh, as a correspondence of the mesh with itself."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import zoomout_core as zo
from meshlab_filter.catalogue import current_id, mesh_filter
from meshlab_filter.filters.match_parameters import ACCURACY
from meshlab_filter.mesh_data import apply_native, read_layer
from meshlab_filter.parameters import CHOICE, COUNT, SWITCH, TEXT, Parameter
from meshlab_filter.stored import Correspondence, attribute_names, check_names, store
from zoomout_core.matching.presets import resolve_detail

if TYPE_CHECKING:
    from pymeshlab import MeshSet

DIRECTIONS = {
    "x": (1, 0, 0),
    "y": (0, 1, 0),
    "z": (0, 0, 1),
    "-x": (-1, 0, 0),
    "-y": (0, -1, 0),
    "-z": (0, 0, -1),
}
# Values, from 0 to 255, of the colour channels that do not show a vertex's side, and of those that do.
DIM, BRIGHT = 70, 235


@mesh_filter(
    Parameter("left", CHOICE, "x", "Axis that points to the character's own left.", tuple(DIRECTIONS)),
    Parameter("candidate", COUNT, 0, "Number of the detected symmetry to use."),
    Parameter("colorsides", SWITCH, False, "Colour the vertices by side: left red, right blue."),
    Parameter(
        "name", TEXT, "symmetry", "Name to store the symmetry under, as a correspondence of the mesh with itself."
    ),
    *ACCURACY,
)
def compute_symmetry_by_zoomout(
    ms: MeshSet, *, left: str, candidate: int, colorsides: bool, name: str, **accuracy: Any
) -> dict[str, Any]:
    """Detect the symmetry of the current mesh, in any pose, and its left and right sides.

    It is stored like a correspondence, together with the custom attribute NAME_side, which is also the quality: the
    signed distance from the symmetry line, positive on the left. Optionally, colours show the sides.

    Returns:
        `triangle`, `barycentric`, `confidence` and `side`, arrays; `candidates`, each with its origin, whether
        it reverses orientation, its order and certainty; `notes`, sentences for the user.

    Raises:
        MeshError: there is no mesh, it is not usable, or no symmetry was found.
        ValueError: there is no candidate with that number.
    """
    mesh_id = current_id(ms)
    layer, mesh = read_layer(ms, mesh_id), ms.mesh(mesh_id)
    check_names(mesh, [*attribute_names(name), f"{name}_side"])
    found = zo.detect_symmetry(layer.shape, left=DIRECTIONS[left], **resolve_detail(**accuracy))
    if not found:
        raise zo.MeshError(f"No symmetry of layer '{layer.label}' was found: it may have none.")
    if candidate >= len(found):
        raise ValueError(f"There is no candidate {candidate}: they are numbered 0 to {len(found) - 1}.")
    symmetry = found[candidate]
    store(mesh, name, Correspondence(symmetry.surface_map, symmetry.confidence), layer)
    mesh.add_vertex_custom_scalar_attribute(symmetry.distance.astype(float), f"{name}_side")
    apply_native(ms, mesh_id, "compute_scalar_by_function_per_vertex", q=f"{name}_side")
    if colorsides:
        # MeshLab calls red, green and blue "x", "y" and "z" here.
        tests = dict(zip("xyz", ("q<0", "q!=0", "q>0"), strict=True))
        colors = {channel: f"({test}) ? {DIM} : {BRIGHT}" for channel, test in tests.items()}
        apply_native(ms, mesh_id, "compute_color_by_function_per_vertex", **colors, a="255")
    return {
        "triangle": symmetry.surface_map.triangle,
        "barycentric": symmetry.surface_map.barycentric,
        "confidence": symmetry.confidence,
        "side": symmetry.distance,
        "candidates": [
            {
                "origin": one.origin,
                "reverses_orientation": one.reverses_orientation,
                "order": one.order,
                "certainty": one.certainty,
            }
            for one in found
        ],
        "notes": list(symmetry.notes),
    }
