# SPDX-License-Identifier: GPL-3.0-or-later
"""The content of a mesh file, independent of its format: attributes, materials and skin."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Floats, Integers, segment_sum
from zoomout_core.mesh.affine_maps import blend_matrices, transform_points
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import unit_vectors
from zoomout_core.runtime.summary import Summary
from zoomout_core.transfer.attribute import Attribute, Domain, Kind
from zoomout_core.transfer.rigging.unpose import inverse_skinning

if TYPE_CHECKING:
    from zoomout_core.assets.stored_map import StoredMap
    from zoomout_core.mesh.formats.gltf_document import Document

# Names of kinds with one attribute each. Texture coordinates and colours are numbered, as there may be several.
WEIGHTS, SHAPE_KEYS, MATERIALS, NORMALS = "weights", "shape keys", "materials", "normals"
UV, COLOR = "uv", "color"

# Characters that end a line, begin a comment or continue a line in OBJ files, and those that UTF-8 cannot store.
UNSTORABLE = re.compile(r"[\x00-\x1f\x7f-\x9f#\\\ud800-\udfff]")


def layers_of(attributes: Iterable[Attribute], kind: str) -> list[Attribute]:
    """Texture coordinates or colours, `UV` or `COLOR`, in the order of their numbers: "uv 2" before "uv 10"."""
    return sorted(
        (each for each in attributes if each.name.startswith(f"{kind} ")), key=lambda each: by_number(each.name)
    )


def by_number(name: str) -> tuple[str, int]:
    """A key that sorts names by the number at their end."""
    text = name.rstrip("0123456789")
    return text, int(name[len(text) :] or 0)


@dataclass(frozen=True)
class Material:
    """The appearance of a face, restricted to what every format can store.

    Attributes:
        name: name shown to the user.
        color: scene-linear base colour, with alpha.
        image: file content of the base colour's image, of any type that `images.image_type` knows.
    """

    name: str
    color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    image: bytes | None = None


@dataclass(frozen=True, eq=False)
class Skin:
    """The joints that deform a mesh, and its rest pose.

    Attributes:
        nodes: (b,) the nodes of the file that are joints.
        names: names of the joints.
        parents: (b,) the number of each joint's parent, -1 for none.
        inverse_bind: (b, 4, 4) transforms from the rest pose to the frame of each joint.
        transforms: (b, 4, 4) transforms from the rest pose to the pose of each joint in the file.
        rest: (n, 3) the vertices in the rest pose.
        linear: (n, 3, 3) matrices that take small differences of posed positions to the rest pose.
        weights: (n, b) sparse; rows sum to one.
    """

    nodes: Integers
    names: tuple[str, ...]
    parents: Integers
    inverse_bind: Floats
    transforms: Floats
    rest: Floats
    linear: Floats
    weights: csr_array


@dataclass(frozen=True, eq=False, repr=False)
class Asset(Summary):
    """All visible meshes of a file as one surface, with their transforms and pose applied.

    Attributes:
        surface: the meshes.
        attributes: `UV` and `COLOR` with a number, `NORMALS`, `SHAPE_KEYS`, and `MATERIALS` with the number of each
            face's material, -1 for none. Texture coordinates begin at the lower left.
        materials: the materials with these numbers.
        skin: the joints that move it; None if there are none.
        document: the document of a glTF file, with its nodes, joints, animations and extensions; None for other
            formats.
        notes: sentences about data that was left out.
        objects: name and number of vertices of each mesh of the file, in the order of the vertices. Empty for formats
            without names.
        nodes: the node of the document that each of these meshes is on. Empty if the document belongs to another mesh;
            the whole surface then becomes one mesh.
        look: the document that has these materials in full, which may be that of another file.
        stored_map: the map from the source of its data, if the file stores it, see `update_asset`.

    Example:
        >>> zo.Asset(source).attributes
        ()
    """

    surface: Surface
    attributes: tuple[Attribute, ...] = ()
    materials: tuple[Material, ...] = ()
    skin: Skin | None = None
    document: Document | None = None
    notes: tuple[str, ...] = ()
    objects: tuple[tuple[str, int], ...] = ()
    nodes: tuple[int, ...] = ()
    look: Document | None = None
    stored_map: StoredMap | None = None

    def _summary(self) -> dict[str, str]:
        return {
            "surface": f"{len(self.surface.vertices):,} vertices, {len(self.surface.face_start) - 1:,} faces",
            "attributes": ", ".join(each.name for each in self.attributes) or "none",
            "materials": ", ".join(each.name for each in self.materials) or "none",
            "joints": str(0 if self.skin is None else len(self.skin.names)),
        }

    def find(self, name: str) -> Attribute | None:
        """The attribute with a name, if there is one."""
        return next((each for each in self.attributes if each.name == name), None)


def to_rest(seen: Floats, weights: csr_array, transforms: Floats) -> tuple[Floats, Floats]:
    """Take posed vertices back to the rest pose of their joints.

    Args:
        seen: (n, 3) posed positions.
        weights: (n, b) weights of the joints.
        transforms: (b, 4, 4) transforms from the rest pose to the pose of each joint.

    Returns:
        (n, 3) positions, and (n, 3, 3) matrices that take small differences of positions there.
    """
    scale = float(np.cbrt(np.abs(np.linalg.det(transforms[:, :3, :3])).mean()))
    rest, linear, _ = inverse_skinning(seen, blend_matrices(transforms[:, :3], weights), scale)
    return rest, linear


def at_rest(asset: Asset) -> Asset:
    """The asset in the rest pose of its joints, with its normals and shape keys in that pose."""
    skin = asset.skin
    if skin is None:
        return asset
    attributes = []
    for each in asset.attributes:
        values = np.asarray(each.values)
        if each.name == SHAPE_KEYS:
            each = replace(each, values=np.einsum("nxy,nky->nkx", skin.linear, values))
        elif each.name == NORMALS:
            inverse = np.linalg.pinv(skin.linear)[asset.surface.corner_vertex]
            each = replace(each, values=unit_vectors(np.einsum("cyx,cy->cx", inverse, values)))
        attributes.append(each)
    still = np.tile(np.eye(4), (len(skin.names), 1, 1))
    linear = np.tile(np.eye(3), (len(skin.rest), 1, 1))
    rest = replace(skin, transforms=still, linear=linear)
    return replace(asset, surface=asset.surface.with_vertices(skin.rest), attributes=tuple(attributes), skin=rest)


def in_pose_of(asset: Asset, other: Asset) -> Asset:
    """An asset at rest in the pose that another one with the same joints has in its file, which inverts `at_rest`."""
    skin = asset.skin
    if skin is None or other.skin is None:
        return asset
    transforms = other.skin.transforms
    matrices = blend_matrices(transforms[:, :3], skin.weights)
    matrices[np.diff(skin.weights.indptr) == 0] = np.eye(4)[:3]
    linear, attributes = np.linalg.pinv(matrices[:, :, :3]), []
    for each in asset.attributes:
        values = np.asarray(each.values)
        if each.name == SHAPE_KEYS:
            each = replace(each, values=np.einsum("nxy,nky->nkx", matrices[:, :, :3], values))
        elif each.name == NORMALS:
            turned = np.einsum("cyx,cy->cx", linear[asset.surface.corner_vertex], values)
            each = replace(each, values=unit_vectors(turned))
        attributes.append(each)
    surface = asset.surface.with_vertices(transform_points(matrices, skin.rest))
    posed = replace(skin, transforms=transforms, linear=linear)
    return replace(asset, surface=surface, attributes=tuple(attributes), skin=posed)


def kind_of(attribute: Attribute) -> str:
    """The name of an attribute, without its number."""
    return attribute.name.rstrip("0123456789").rstrip()


def material_numbers(values: Integers) -> Attribute:
    """Make the attribute of the faces' material numbers (f,)."""
    return Attribute(MATERIALS, Domain.FACE, Kind.LABEL, values)


def on_points(attribute: Attribute, surface: Surface) -> Floats:
    """(n, w) values at the vertices, averaged over their corners."""
    values = np.asarray(attribute.values, dtype=np.float64)
    if attribute.domain is Domain.POINT:
        return values
    sums = segment_sum(values, surface.corner_vertex, len(surface.vertices))
    count = np.bincount(surface.corner_vertex, minlength=len(surface.vertices))
    return np.asarray(sums / np.maximum(count, 1)[:, None])


def on_corners(attribute: Attribute, surface: Surface) -> Floats:
    """(c, w) values at the corners, from their vertices."""
    values = np.asarray(attribute.values, dtype=np.float64)
    return values if attribute.domain is Domain.CORNER else values[surface.corner_vertex]


def from_srgb(colors: Floats) -> Floats:
    """Convert sRGB colours (n, 3) or (n, 4) to scene-linear ones; alpha is not changed."""
    values = np.array(colors, dtype=np.float64)
    rgb = np.clip(values[:, :3], 0, 1)
    values[:, :3] = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return values


def to_srgb(colors: Floats) -> Floats:
    """Linear colours (n, 3 or 4) in [0, 1] as sRGB, with alpha unchanged; the inverse of `from_srgb`."""
    values = np.array(colors, dtype=np.float64)
    rgb = np.clip(values[:, :3], 0, 1)
    values[:, :3] = np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1 / 2.4) - 0.055)
    return values


def one_line(name: str) -> str:
    """A name as formats of lines can store it: without line breaks, control characters, comments and continuations."""
    return UNSTORABLE.sub("_", " ".join(name.split())) or "unnamed"
