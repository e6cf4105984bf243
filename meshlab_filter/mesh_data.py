# SPDX-License-Identifier: GPL-3.0-or-later
"""Conversion between pymeshlab layers and the core's surfaces and attributes; no other module knows both.

A layer without faces is treated as points of a surface, which is reconstructed from them, with the points as vertices.
MeshLab stores triangles (polygons are triangles with "faux" edges between them) and texture coordinates at
their corners (wedges). On an existing mesh only custom attributes can be set, and the
constructor does not take textures, selections and faux edges; so a new layer is loaded from a PLY file in
a temporary folder. pymeshlab is imported when a mesh is read: loaded before bpy it would prevent bpy from
loading.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from meshlab_filter.catalogue import check_mesh
from meshlab_filter.layer import TEXCOORD, Layer
from meshlab_filter.layer_ply import encode_ply
from meshlab_filter.textures import Textures, save_images, texture_coordinates, texture_numbers
from zoomout_core.arrays import Booleans, Floats
from zoomout_core.assets.asset import from_srgb
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.point_cloud import PointCloud
from zoomout_core.mesh.shapes import as_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import unit_vectors
from zoomout_core.messages import plural
from zoomout_core.transfer import Attribute, Domain, Kind

if TYPE_CHECKING:
    from pymeshlab import Mesh, MeshSet


@dataclass(frozen=True)
class Component:
    """A standard attribute that a mesh may have on its vertices or faces.

    Attributes:
        name: its name in pymeshlab.
        domain: vertices or faces.
        kind: the kind of values.
        getter: name of the mesh's method that returns the values.
        blanks: MeshLab's default values.
    """

    name: str
    domain: Domain
    kind: Kind
    getter: str
    blanks: tuple[float | tuple[float, ...], ...]

    def is_in(self, mesh: Mesh) -> bool:
        """Whether a mesh has the component; every mesh has selections."""
        return self.kind is Kind.BOOLEAN or getattr(mesh, f"has_{self.name}")()

    def is_blank(self, values: Floats | Booleans) -> bool:
        """Whether the values may be MeshLab's defaults: all are the same blank."""
        return any(bool((values == np.asarray(blank)).all()) for blank in self.blanks)


# White, and the light grey of faces in OBJ files that have texture coordinates but no material.
BLANK_COLORS = ((1, 1, 1, 1), (192 / 255, 192 / 255, 192 / 255, 1))

COMPONENTS = (
    Component("vertex_color", Domain.POINT, Kind.COLOR, "vertex_color_matrix", BLANK_COLORS),
    Component("face_color", Domain.FACE, Kind.COLOR, "face_color_matrix", BLANK_COLORS),
    Component("vertex_scalar", Domain.POINT, Kind.SCALAR, "vertex_scalar_array", (0,)),
    Component("face_scalar", Domain.FACE, Kind.SCALAR, "face_scalar_array", (0,)),
    Component("vertex_selection", Domain.POINT, Kind.BOOLEAN, "vertex_selection_array", (0,)),
    Component("face_selection", Domain.FACE, Kind.BOOLEAN, "face_selection_array", (0,)),
)

# Methods that read and add custom attributes.
CUSTOM = {
    (Domain.POINT, Kind.SCALAR): ("vertex_custom_scalar_attribute_array", "add_vertex_custom_scalar_attribute"),
    (Domain.POINT, Kind.VECTOR): ("vertex_custom_point_attribute_matrix", "add_vertex_custom_point_attribute"),
    (Domain.FACE, Kind.SCALAR): ("face_custom_scalar_attribute_array", "add_face_custom_scalar_attribute"),
    (Domain.FACE, Kind.VECTOR): ("face_custom_point_attribute_matrix", "add_face_custom_point_attribute"),
}
# Prefixes of the parameters with which pymeshlab writes custom attributes to a PLY file, such as `__ca_vs__NAME`.
IN_PLY = "__ca_"


def read_layer(ms: MeshSet, mesh_id: int, custom: Iterable[str] = ()) -> Layer:
    """Read a layer of a MeshSet with the custom attributes of the given names.

    Raises:
        MeshError: the layer or an attribute does not exist, or the layer is neither a surface nor points of one.
    """
    shape = read_shape(ms, mesh_id)
    mesh = ms.mesh(mesh_id)
    components, textures, number = _components(mesh), None, None
    coordinates = texture_coordinates(mesh)
    if coordinates is not None:
        names, number = texture_numbers(mesh)
        textures = Textures.of(names, mesh.textures(), coordinates, number)
        in_one_texture = textures.in_one_texture(coordinates, number)
        components[TEXCOORD] = Attribute(TEXCOORD, Domain.CORNER, Kind.UV, in_one_texture)
    return Layer(
        label=mesh.label(),
        shape=shape,
        vertices=mesh.vertex_matrix(),
        normals=mesh.vertex_normal_matrix(),
        edges=mesh.edge_matrix(),
        faux=_faux_edges(mesh),
        transform=mesh.transform_matrix(),
        components=components,
        custom=tuple(attribute for name in custom for attribute in custom_attributes(mesh, name)),
        textures=textures,
        texture=number,
    )


def read_shape(ms: MeshSet, mesh_id: int) -> Surface | PointCloud:
    """Read the surface of a layer of a MeshSet, or its points if it has no faces.

    Raises:
        MeshError: the layer does not exist, or it is neither.
    """
    check_mesh(ms, mesh_id)
    mesh = ms.mesh(mesh_id)
    with _naming(mesh):
        if mesh.vertex_number() == 0:
            raise MeshError("It is empty: load a mesh or points.")
        places = mesh.transformed_vertex_matrix()
        if mesh.face_number() > 0:
            return Surface(places, mesh.face_matrix())
        normals = turn_normals(mesh.vertex_normal_matrix(), mesh.transform_matrix())
        cloud = PointCloud(places, normals if normals.any(axis=1).all() else None)
        as_surface(cloud)  # the surface is cached, and the points have been checked
        return cloud


def turn_normals(normals: Floats, transform: Floats) -> Floats:
    """(n, 3) unit normals of a layer in the global frame; zero for none."""
    # Normals transform by the inverse transpose; for row vectors, that is the inverse.
    return unit_vectors(normals @ np.linalg.inv(transform[:3, :3]))


@contextmanager
def _naming(mesh: Mesh) -> Iterator[None]:
    """A context manager that adds the layer's name to error messages."""
    try:
        yield
    except MeshError as error:
        raise MeshError(f"Layer '{mesh.label()}': {error}") from error


def _components(mesh: Mesh) -> dict[str, Attribute]:
    found = {}
    for component in COMPONENTS:
        if not component.is_in(mesh):
            continue
        values = getattr(mesh, component.getter)()
        if not component.is_blank(values):
            if component.kind is Kind.COLOR:
                values = from_srgb(values)
            found[component.name] = Attribute(component.name, component.domain, component.kind, values)
    return found


def custom_attributes(mesh: Mesh, name: str) -> list[Attribute]:
    """The custom attributes of a name; there may be one of each type.

    Raises:
        MeshError: there is none.
    """
    found = _those_of(mesh, name)
    if not found:
        raise MeshError(f"Layer '{mesh.label()}' has no custom attribute '{name}': check the name.")
    return found


def custom_names(ms: MeshSet, mesh_id: int) -> list[str]:
    """The names of a mesh's custom attributes that consist of letters, digits and underscores.

    pymeshlab has no list of them, but can write them to PLY files, and lists those.
    """
    check_mesh(ms, mesh_id)
    current = ms.current_mesh_id()
    ms.set_current_mesh(mesh_id)
    offered = custom_in_ply(ms)
    ms.set_current_mesh(current)
    names = dict.fromkeys(key.split("__", 2)[2] for key in offered)
    return [name for name in names if _those_of(ms.mesh(mesh_id), name)]


def has_attribute(mesh: Mesh, name: str) -> bool:
    """Whether a mesh has a custom attribute of that name."""
    return bool(_those_of(mesh, name))


def attribute_values(mesh: Mesh, name: str) -> Floats:
    """The values (n,) or (n, 3) of a custom attribute of vertices.

    Raises:
        MeshError: there is none.
    """
    for attribute in custom_attributes(mesh, name):
        if attribute.domain is Domain.POINT:
            return np.asarray(attribute.values)
    raise MeshError(f"Layer '{mesh.label()}' has the custom attribute '{name}' for faces only: check the name.")


def custom_in_ply(ms: MeshSet) -> list[str]:
    """The parameters by which pymeshlab writes the current mesh's custom attributes to a PLY file."""
    return [name for name in ms.filter_parameter_values("ply") if name.startswith(IN_PLY)]


def _those_of(mesh: Mesh, name: str) -> list[Attribute]:
    import pymeshlab

    found = []
    for (domain, kind), (getter, _) in CUSTOM.items():
        try:
            found.append(Attribute(name, domain, kind, getattr(mesh, getter)(name)))
        except pymeshlab.PyMeshLabException:
            continue  # no attribute of this type has that name
    return found


def _faux_edges(mesh: Mesh) -> Booleans:
    """(m, 3) which edges of triangles are not edges of a polygon."""
    if mesh.face_number() == 0:
        return np.zeros((0, 3), dtype=bool)
    polygons, triangles = mesh.polygonal_face_list(), mesh.face_matrix()
    if len(polygons) == len(triangles):
        return np.zeros(triangles.shape, dtype=bool)
    size = np.array([len(polygon) for polygon in polygons])
    start = np.cumsum(size) - size
    corner = np.concatenate(polygons).astype(np.int64)
    following = np.roll(corner, -1)
    following[start + size - 1] = corner[start]
    count = triangles.max() + 1
    ends = np.roll(triangles, -1, axis=1)
    return ~np.isin(triangles.astype(np.int64) * count + ends, corner * count + following)


# --- writing ------------------------------------------------------------------------------------------------


def check_target(layer: Layer) -> None:
    """Check that `add_layer` can make a layer with these vertices and triangles.

    Raises:
        MeshError: MeshLab would drop some of them on reading.
    """
    twice = (layer.faces == np.roll(layer.faces, 1, axis=1)).any(axis=1).sum()
    if twice:
        raise MeshError(
            plural(
                int(twice),
                "Layer '{name}' has 1 face that uses a vertex twice, which MeshLab does not accept: remove it with the "
                "filter meshing_remove_null_faces.",
                "Layer '{name}' has {count} faces that use a vertex twice, which MeshLab does not accept: remove them "
                "with the filter meshing_remove_null_faces.",
                name=layer.label,
            )
        )
    lost = (~np.isfinite(layer.vertices).all(axis=1)).sum()
    if lost:
        raise MeshError(
            plural(
                int(lost),
                "Layer '{name}' has 1 vertex that is not finite, which MeshLab does not accept: remove it with the "
                "filter meshing_remove_unreferenced_vertices.",
                "Layer '{name}' has {count} vertices that are not finite, which MeshLab does not accept: remove them "
                "with the filter meshing_remove_unreferenced_vertices.",
                name=layer.label,
            )
        )


def apply_native(ms: MeshSet, mesh_id: int, name: str, /, **parameters: Any) -> None:
    """Apply one of MeshLab's filters to a mesh without changing the current mesh."""
    current = ms.current_mesh_id()
    ms.set_current_mesh(mesh_id)
    try:
        ms.apply_filter(name, **parameters)
    finally:
        ms.set_current_mesh(current)


def add_layer(ms: MeshSet, layer: Layer) -> int:
    """Add a layer to a MeshSet as its current mesh; polygons are preserved unless there are texture coordinates.

    Returns:
        The id of the new mesh.
    """
    with TemporaryDirectory() as folder:
        names = [] if layer.textures is None else save_images(layer.textures, Path(folder))
        path = Path(folder) / "layer.ply"
        path.write_bytes(encode_ply(layer, names))
        ms.load_new_mesh(str(path))
    if not np.array_equal(layer.transform, np.eye(4)):
        ms.apply_filter("set_matrix", transformmatrix=layer.transform, freeze=False)
    mesh = ms.current_mesh()
    mesh.set_label(layer.label)
    for attribute in layer.custom:
        getattr(mesh, CUSTOM[attribute.domain, attribute.kind][1])(attribute.values, attribute.name)
    return int(mesh.id())
