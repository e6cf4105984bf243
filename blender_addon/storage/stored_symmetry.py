# SPDX-License-Identifier: GPL-3.0-or-later
"""The symmetries of a mesh, stored on it as attributes for each candidate and a custom property that describes them.

Symmetries belong to the mesh without its modifiers, so neither a pose nor a subdivision matters. The names of
attributes begin with a dot, which hides them in Blender's lists. The positions of the vertices are stored as well, to
detect later sculpting.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from bpy.types import Mesh, Object

import zoomout_core as zo
from zoomout_core import symmetry as core_symmetry
from zoomout_core.arrays import Bytes, Floats
from zoomout_core.maps.surface_map import fault_of_map
from zoomout_core.messages import as_message, message, probability, to_json
from zoomout_core.transfer import Attribute, Domain, Kind

from ..colors import pair_colors
from ..mesh_data import (
    SYMMETRY_ATTRIBUTES,
    Layer,
    Role,
    content_hash,
    positions_in_world,
    read_faces,
    read_layer,
    read_rest_positions,
    read_surface_at_rest,
    write_layer,
)
from ..mesh_data.arrays import from_text, hash_of, to_text
from .stored_json import Kind as JsonKind
from .stored_json import read_json

PROPERTY = "zoomout_symmetry"
# The entries of a description.
ENTRIES: dict[str, JsonKind] = {
    "candidates": [
        {
            "name": str,
            "reverses_orientation": bool,
            "order": (None, int),
            "certainty": (int, float),
            "sides": bool,
            "notes": [str],
        }
    ],
    "pictures": (None, [str]),
    "key": (None, str),
    "points": (None, str),
    "chosen": int,
    "vertices": int,
    "faces": int,
    "fingerprint": str,
    "topology": str,
    "content": (None, str),
}
REST = f"{SYMMETRY_ATTRIBUTES}rest"
# Number of vertices in the thumbnail of a candidate.
PICTURED = 800
# The parts of each candidate, and their types in Blender.
PARTS = {
    "triangle": (Kind.LABEL, "INT"),
    "barycentric": (Kind.VECTOR, "FLOAT_VECTOR"),
    "confidence": (Kind.SCALAR, "FLOAT"),
    "distance": (Kind.SCALAR, "FLOAT"),
}


def rest_surface(obj: Object) -> zo.Surface:
    """The surface of an object's own mesh, in its own space, before shape keys and modifiers move it.

    Raises:
        MeshError: there is no surface.
    """
    return read_surface_at_rest(obj, positions=read_rest_positions(obj.data))


def fingerprint_of(surface: zo.Surface) -> str:
    """A hash of a surface, to detect edits."""
    return hash_of("", surface.vertices, surface.corner_vertex, surface.face_start)


def fingerprint(obj: Object) -> str:
    """`fingerprint_of` the `rest_surface`, without building it."""
    return hash_of("", *_elements(obj))


def write(obj: Object, found: Sequence[zo.Symmetry], left: str) -> None:
    """Store the symmetries of an object's mesh, the most likely first; they replace earlier ones.

    Args:
        obj: the object.
        found: symmetries of its `rest_surface`.
        left: the axis to the left, as the user chose it.
    """
    mesh = obj.data
    forget(mesh)
    for number, symmetry in enumerate(found):
        maps = {"triangle": symmetry.surface_map.triangle, "barycentric": symmetry.surface_map.barycentric}
        _write_parts(mesh, number, maps | {"confidence": symmetry.confidence, "distance": symmetry.distance})
    points, colors = _pictures(obj, found)
    mesh[PROPERTY] = json.dumps(
        {
            "candidates": to_json([describe(symmetry) for symmetry in found]),
            "pictures": [to_text(color, np.uint8) for color in colors],
            "key": hash_of("", points, *colors),
            "points": to_text(points, np.float32),
            "chosen": 0,
            "left": left,
            "vertices": len(mesh.vertices),
            "faces": len(mesh.polygons),
        }
    )
    store_shape(obj)


def store_shape(obj: Object) -> None:
    """Store the present shape of an object's mesh as the one that its symmetry refers to."""
    mesh, (vertices, *faces) = obj.data, _elements(obj)
    _write(mesh, REST, Kind.VECTOR, "FLOAT_VECTOR", vertices)
    fingerprint, content = hash_of("", vertices, *faces), content_hash(mesh)
    _update(mesh, topology=hash_of("", *faces), fingerprint=fingerprint, content=content)
    mesh.update()


def description(mesh: Mesh) -> dict[str, Any] | None:
    """The description of a mesh's symmetries, or None if there are none, or a part is missing or damaged.

    Returns:
        `candidates`: for each its `name`, `certainty`, whether it has `sides`, and `notes`, sentences for the user;
        `chosen`: the number of one of them; `left`: the axis to the left; `vertices` and `faces`: their numbers when
        the symmetries were stored; `content`: see `mesh_data.content_hash`; `pictures`: for each candidate the colours
        of some `points` of the mesh in world space, as text; `key`: an identifier of the pictures.
    """
    stored = read_json(mesh, PROPERTY, ENTRIES)
    if stored is None or not 0 <= stored["chosen"] < len(stored["candidates"]):
        return None
    needed = [REST, *(_name(number, part) for number in range(len(stored["candidates"])) for part in PARTS)]
    return stored if all(name in mesh.attributes for name in needed) else None


def describe(symmetry: zo.Symmetry) -> dict[str, Any]:
    """The description of a symmetry, without map and thumbnail, for the candidates of `description`."""
    turn = message("Rotation of order {order}", order=symmetry.order) if symmetry.order else "Rotation"
    turn = "Half turn" if symmetry.order == 2 else turn
    reflection = "Reflection" if symmetry.order == 2 else "Mirrored rotation"
    return {
        "name": reflection if symmetry.reverses_orientation else turn,
        "reverses_orientation": symmetry.reverses_orientation,
        "order": symmetry.order,
        "certainty": symmetry.certainty,
        "sides": symmetry.has_sides,
        "notes": symmetry.notes,
    }


def is_outdated(mesh: Mesh, stored: dict[str, Any]) -> bool:
    """Whether the number of vertices or faces has changed; `read` compares their content."""
    return (stored["vertices"], stored["faces"]) != (len(mesh.vertices), len(mesh.polygons))


def thumbnails(stored: dict[str, Any]) -> list[tuple[str, Floats, Bytes]]:
    """Name of the thumbnail, points (s, 3) and their colours, 0 to 255, for each candidate of a `description`."""
    if "pictures" not in stored:
        return []
    points = from_text(stored["points"], np.float32, 3)
    colors = [from_text(picture, np.uint8, 3) for picture in stored["pictures"]]
    return [(f"{stored['key']} {number}", points, color) for number, color in enumerate(colors)]


def chosen_attributes(mesh: Mesh) -> list[str]:
    """The names of the attributes that store the chosen symmetry; empty if there is none."""
    stored = description(mesh)
    return [] if stored is None else [_name(stored["chosen"], part) for part in PARTS]


def has_sides(mesh: Mesh) -> bool:
    """Whether the chosen symmetry has a left and a right side."""
    stored = description(mesh)
    return stored is not None and bool(stored["candidates"][stored["chosen"]]["sides"])


def order(mesh: Mesh) -> int:
    """Order of the chosen symmetry: the number of repetitions that give the identity, 0 if no small number does."""
    stored = description(mesh)
    return int(stored["candidates"][stored["chosen"]].get("order", 0)) if stored else 0


def read(obj: Object) -> core_symmetry.self_map.SelfMap:
    """The chosen symmetry of an object whose mesh has not changed.

    Raises:
        MeshError: no symmetry is stored, or the mesh was edited since.
    """
    stored, now = _required_description(obj), _surface_now(obj)
    if stored["fingerprint"] != fingerprint_of(now):
        raise zo.MeshError(
            "'{name}' was reshaped since its symmetry was detected: use Mirror Sculpt, or detect the symmetry again.",
            name=obj.name,
        )
    return _chosen_symmetry(obj.data, stored, now)


def read_with_sculpt(obj: Object) -> tuple[core_symmetry.self_map.SelfMap, Floats]:
    """The chosen symmetry, of the mesh when it was detected, and the offsets (n, 3) of vertices since.

    Raises:
        MeshError: no symmetry is stored, or the vertices or faces of the mesh were changed since.
    """
    stored, now = _required_description(obj), _surface_now(obj)
    before = now.with_vertices(read_layer(obj.data, REST).attribute.values)
    return _chosen_symmetry(obj.data, stored, before), now.vertices - before.vertices


def choose(mesh: Mesh, number: int) -> None:
    """Use another candidate."""
    _update(mesh, chosen=number)


def swap_sides(obj: Object) -> None:
    """Swap left and right of the chosen symmetry.

    Raises:
        MeshError: no symmetry is stored, or the chosen one has no sides.
    """
    number = _required_description(obj)["chosen"]
    if not _required_description(obj)["candidates"][number]["sides"]:
        raise zo.MeshError("This symmetry has no left and right side: choose a reflection.")
    distance = read_layer(obj.data, _name(number, "distance")).attribute.values
    _write_parts(obj.data, number, {"distance": -distance})
    obj.data.update()


def forget(mesh: Mesh) -> None:
    """Remove the stored symmetries of a mesh."""
    for name in [one.name for one in mesh.attributes if one.name.startswith(SYMMETRY_ATTRIBUTES)]:
        mesh.attributes.remove(mesh.attributes[name])
    if PROPERTY in mesh:
        del mesh[PROPERTY]


def _pictures(obj: Object, found: Sequence[zo.Symmetry]) -> tuple[Floats, list[Bytes]]:
    """Points (s, 3) of the object's mesh in world space, and their colours for each of its symmetries."""
    surface = found[0].surface
    used = np.unique(surface.triangles)
    some = np.random.default_rng(0).permutation(used)[:PICTURED]
    colors = [pair_colors(symmetry, symmetry.order)[some] for symmetry in found]
    return positions_in_world(obj, surface.vertices[some]), [np.rint(255 * color).astype(np.uint8) for color in colors]


def _surface_now(obj: Object) -> zo.Surface:
    """The surface of a mesh, after checking that its faces are those that the symmetry was detected on."""
    surface = rest_surface(obj)
    if _required_description(obj)["topology"] != hash_of("", surface.corner_vertex, surface.face_start):
        raise zo.MeshError(
            "The mesh of '{name}' was edited since its symmetry was detected: detect it again.", name=obj.name
        )
    return surface


def _chosen_symmetry(mesh: Mesh, stored: dict[str, Any], surface: zo.Surface) -> core_symmetry.self_map.SelfMap:
    """The chosen symmetry of a mesh, on the surface that it was detected on."""
    values = {name: read_layer(mesh, _name(stored["chosen"], name)).attribute.values for name in PARTS}
    # They are stored in single precision: rescale them to a sum of one.
    barycentric = values["barycentric"].astype(np.float64)
    if (
        fault_of_map(values["triangle"], barycentric, len(surface.triangles))
        or not np.isfinite(values["distance"]).all()
    ):
        raise zo.MeshError("The symmetry stored on '{mesh}' is damaged: detect it again.", mesh=mesh.name)
    barycentric /= barycentric.sum(axis=1, keepdims=True)
    return core_symmetry.self_map.SelfMap(
        surface=surface,
        surface_map=zo.SurfaceMap(values["triangle"].astype(np.int64), barycentric, surface.triangles),
        confidence=values["confidence"].astype(np.float64),
        reverses_orientation=stored["candidates"][stored["chosen"]]["reverses_orientation"],
        distance=values["distance"].astype(np.float64),
    )


def _elements(obj: Object) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, corners and starts of faces of the `rest_surface`, without building it."""
    faces = read_faces(obj.data)
    start = np.append(faces.start, len(faces.corner_vertex)).astype(np.int64)
    return read_rest_positions(obj.data).astype(np.float64), faces.corner_vertex.astype(np.int64), start


def _required_description(obj: Object) -> dict[str, Any]:
    stored = description(obj.data)
    if stored is None:
        raise zo.MeshError("'{name}' has no detected symmetry: detect it first.", name=obj.name)
    return stored


def _name(number: int, part: str) -> str:
    return f"{SYMMETRY_ATTRIBUTES}{number}_{part}"


def _write_parts(mesh: Mesh, number: int, parts: dict[str, np.ndarray]) -> None:
    for part, values in parts.items():
        _write(mesh, _name(number, part), *PARTS[part], values)


def _write(mesh: Mesh, name: str, kind: Kind, data_type: str, values: np.ndarray) -> None:
    write_layer(mesh, Layer(Attribute(name, Domain.POINT, kind, values), Role.GENERIC, data_type))


def _update(mesh: Mesh, **values: Any) -> None:
    mesh[PROPERTY] = json.dumps(json.loads(mesh[PROPERTY]) | values)


def summary(candidate: dict[str, Any]) -> str:
    """A candidate of `description` in a few words."""
    return message(
        "{name}, {certainty}", name=as_message(candidate["name"]), certainty=probability(candidate["certainty"])
    )
