# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes to try things on: creatures whose true correspondence is known, in any pose and of any triangles.

A creature is a sphere with limbs drawn out of it, given as a function of the direction from its centre. Every choice of
directions is another mesh of the same surface, and the same direction is the same place. A pose bends the limbs, which
leaves distances along the surface nearly as they were.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Floats, Integers
from zoomout_core.assets.asset import COLOR, UV, Asset, Material, Skin, material_numbers
from zoomout_core.assets.files import write_asset
from zoomout_core.assets.gltf import Buffer, Document, library
from zoomout_core.colors import place_colors
from zoomout_core.mesh.decimation import decimate
from zoomout_core.mesh.files import read_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import unit_vectors
from zoomout_core.mesh.voxel_remesh import voxel_remesh
from zoomout_core.transfer.attribute import Attribute, Domain, Kind
from zoomout_core.transfer.skinning import blend_matrices, transform_points

if TYPE_CHECKING:
    from pygltflib import GLTF2

# Directions, lengths and sharpness of the limbs; x is the creature's left, -y its front, z points up.
NAMES = ("Arm.L", "Arm.R", "Leg.L", "Leg.R", "Head", "Tail")
LIMBS = np.array([[1, 0.1, 0.35], [-1, 0.1, 0.35], [0.45, 0, -1], [-0.45, 0, -1], [0, 0.05, 1], [0, 1, -0.25]])
LENGTHS = np.array([2.6, 2.6, 3.2, 3.2, 0.8, 2.0])
SHARPNESS = np.array([70.0, 70.0, 70.0, 70.0, 9.0, 90.0])
# How thick the body is from front to back.
FLAT = np.array([1, 0.7, 1])
# Where limbs begin to bend, from the centre.
BODY = 1.05

# From the creature's frame to that of glTF, in which y points up.
UPRIGHT = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
# How the scan stands: turns of its limbs in glTF's frame, in degrees about x, y and z.
STANCE: Mapping[str, tuple[float, float, float]] = {
    "Arm.L": (0, 0, -45),
    "Arm.R": (0, 35, -30),
    "Leg.L": (-35, 0, 0),
    "Leg.R": (25, 0, 0),
    "Head": (0, 25, 0),
    "Tail": (-30, 0, 0),
}
# Vertices and voxels along the longest extent of what is remeshed.
FINE, VOXELS = 20000, 120
# Turns of the waving arm, in degrees.
WAVE = 0.0, 50.0, 0.0, 50.0, 0.0
# How far beyond the body a limb begins to move with its joint, and how far it moves with it alone.
LIMB_BEGINS, LIMB_IS_FREE = 0.1, 1.0
# Pixels and squares along the side of the texture; of how many vertices of the scan the truth names one.
TEXELS, SQUARES, PAIRS_EVERY = 128, 8, 10


@dataclass(frozen=True)
class Creature:
    """A mesh with the direction (n, 3) that each vertex stands for."""

    surface: Surface
    directions: Floats


def creature(
    count: int = 4000, seed: int = 0, bend: float = 0.0, asymmetry: float = 0.0, without: int | None = None
) -> Creature:
    """A creature with two arms, two legs, a head and a tail.

    Args:
        count: of vertices.
        seed: of the mesh; the surface is the same for every seed.
        bend: of the limbs, in radians from body to tip.
        asymmetry: how much longer the left limbs are than the right ones.
        without: the number of a limb that it lacks.
    """
    where = directions(count, seed)
    lengths = LENGTHS * (1 + asymmetry * np.sign(LIMBS[:, 0])) * (np.arange(len(LIMBS)) != without)
    triangles = ConvexHull(where).simplices
    a, b, c = (where[triangles[:, i]] for i in range(3))
    outward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) > 0
    triangles = np.where(outward[:, None], triangles, triangles[:, ::-1])
    return Creature(Surface(posed(_at_rest(where, lengths), bend), triangles), where)


def _at_rest(where: Floats, lengths: Floats) -> Floats:
    """(n, 3) the places in some directions (n, 3), with limbs of some lengths."""
    return where * (1 + _shapes(where) @ lengths)[:, None] * FLAT


def _shapes(where: Floats) -> Floats:
    """(n, limbs) how far each limb draws what is in some directions (n, 3) out, as shares of its length."""
    return np.exp(SHARPNESS * (where @ (LIMBS / np.linalg.norm(LIMBS, axis=1, keepdims=True)).T - 1))


def directions(count: int, seed: int) -> Floats:
    """(count, 3) irregular but even points on the sphere."""
    i = np.arange(count) + 0.5
    height, turn = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    ring = np.sqrt(1 - height**2)
    points = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])
    random = np.random.default_rng(seed)
    points = points @ np.linalg.qr(random.standard_normal((3, 3)))[0]
    points += random.normal(scale=0.25 / np.sqrt(count), size=points.shape)
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))


def true_vertex(source: Creature, target: Creature) -> Integers:
    """(n_t,) the source vertex at, or nearest to, each target vertex's place."""
    return np.asarray(cKDTree(source.directions).query(target.directions)[1])


def body(count: int = 5000, seed: int = 0) -> Creature:
    """The creature at rest, with triangles of about one size, as remeshers make them, in glTF's frame: y points up.

    Args:
        count: of vertices, about.
        seed: of the triangles.
    """
    turn = Rotation.from_rotvec(seed * np.array([0.3, 0.5, 0.7]))
    fine = creature(FINE).surface
    vertices, triangles = voxel_remesh(turn.apply(fine.vertices), fine.triangles, VOXELS)
    vertices, triangles = decimate(vertices, triangles, count)[:2]
    where = unit_vectors(turn.apply(vertices, inverse=True) / FLAT)
    return Creature(Surface(_at_rest(where, LENGTHS) @ UPRIGHT.T, triangles), where)


def character(count: int = 5000) -> Asset:
    """A creature as a game has it: texture coordinates, a texture, two materials, colours, joints and an animation.

    Args:
        count: of vertices, about.

    Raises:
        ImportError: pygltflib, of the extra `cli`, is not installed.
    """
    made = body(count)
    surface = made.surface
    limb = limb_weights(made.directions)[:, 1:].max(axis=1)
    of_face = (limb[surface.triangles].mean(axis=1) > 0.5).astype(int)
    return Asset(
        surface,
        (
            Attribute(f"{UV} 0", Domain.CORNER, Kind.UV, _texture_coordinates(made)),
            Attribute(f"{COLOR} 0", Domain.POINT, Kind.COLOR, place_colors(surface.vertices, surface.vertices)),
            material_numbers(of_face),
        ),
        (Material("Body", image=checker()), Material("Limbs", (0.9, 0.8, 0.6, 1.0), checker())),
        _skin(surface, made.directions),
        Document.from_gltf(_skeleton()),
    )


def scan(count: int = 4000, seed: int = 1) -> Creature:
    """The same creature as if it were scanned: in another stance, of other triangles, and in glTF's frame.

    Args:
        count: of vertices, about.
        seed: of the triangles.
    """
    made = body(count, seed)
    return Creature(in_stance(made), made.directions)


def in_stance(made: Creature) -> Surface:
    """A creature that is at rest in glTF's frame, in the stance of the scan."""
    surface = made.surface
    transforms = np.tile(np.eye(4)[:3], (1 + len(NAMES), 1, 1))
    for number, (name, joint) in enumerate(zip(NAMES, joints(), strict=True), start=1):
        turn = Rotation.from_euler("xyz", STANCE[name], degrees=True).as_matrix()
        transforms[number] = np.column_stack([turn, joint - turn @ joint])
    matrices = blend_matrices(transforms, csr_array(limb_weights(made.directions)))
    return surface.with_vertices(transform_points(matrices, surface.vertices))


def write_samples(folder: str | PathLike[str]) -> tuple[Path, ...]:
    """Write `character.glb`, `scan.ply` and `truth.txt`, pairs of their vertices that truly correspond.

    Returns:
        The paths of the three files.

    Raises:
        OutputError: they could not be written.
        ImportError: the packages of the extra `cli` are not installed.
    """
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    files = tuple(place / name for name in ("character.glb", "scan.ply", "truth.txt"))
    made, scanned = body(), scan()
    write_asset(character(), files[0])
    write_asset(Asset(scanned.surface), files[1])
    # Programs number the vertices of a glTF file in ways of their own.
    number = np.asarray(cKDTree(read_surface(files[0]).vertices).query(made.surface.vertices)[1])
    some = np.arange(0, len(scanned.directions), PAIRS_EVERY)
    pairs = np.column_stack([number[true_vertex(made, scanned)[some]], some])
    files[2].write_text("".join(f"{source} {target}\n" for source, target in pairs), encoding="utf-8")
    return files


def limb_weights(where: Floats) -> Floats:
    """(n, 1 + limbs) how far the body and each limb move what is in some directions (n, 3); rows sum to one."""
    height = LENGTHS * _shapes(where)
    limbs = np.clip((height - LIMB_BEGINS) / (LIMB_IS_FREE - LIMB_BEGINS), 0, 1)
    return np.column_stack([1 - limbs.sum(axis=1), limbs])


def joints() -> Floats:
    """(limbs, 3) where each limb turns, in glTF's frame."""
    return LIMBS / np.linalg.norm(LIMBS, axis=1, keepdims=True) * FLAT @ UPRIGHT.T


def checker() -> bytes:
    """A PNG file of a checker whose squares differ in hue."""
    place = np.arange(TEXELS) * SQUARES // TEXELS
    shade = np.where((place[:, None] + place) % 2, 1.0, 0.7)
    hue = np.stack(np.broadcast_arrays(place[:, None], SQUARES - 1 - place, SQUARES // 2), axis=-1) / (SQUARES - 1)
    pixels = (255 * shade[:, :, None] * (0.4 + 0.6 * hue)).astype(np.uint8)
    rows = np.column_stack([np.zeros((TEXELS, 1), np.uint8), pixels.reshape(TEXELS, -1)]).tobytes()
    header = struct.pack(">IIBBBBB", TEXELS, TEXELS, 8, 2, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in chunks
    )


def _texture_coordinates(made: Creature) -> Floats:
    """(c, 2) of the corners: longitude and latitude of the directions, with a seam at the back."""
    where = made.directions[made.surface.corner_vertex]
    across = (np.arctan2(where[:, 0], -where[:, 1]) / np.pi + 1) / 2
    of_face = across.reshape(-1, 3)
    of_face += (of_face < 0.5) & (np.ptp(of_face, axis=1, keepdims=True) > 0.5)
    return np.column_stack([of_face.ravel(), 1 - np.arccos(where[:, 2]) / np.pi])


def _skin(surface: Surface, where: Floats) -> Skin:
    """The joints of a creature that stands at rest."""
    count = 1 + len(NAMES)
    inverse_bind = np.tile(np.eye(4), (count, 1, 1))
    inverse_bind[1:, :3, 3] = -joints()
    return Skin(
        nodes=np.arange(count),
        names=("Body", *NAMES),
        parents=np.array([-1, *[0] * len(NAMES)]),
        inverse_bind=inverse_bind,
        transforms=np.tile(np.eye(4), (count, 1, 1)),
        rest=surface.vertices,
        linear=np.tile(np.eye(3), (len(surface.vertices), 1, 1)),
        weights=csr_array(limb_weights(where)),
    )


def _skeleton() -> GLTF2:
    """A glTF document with the joints, the first of the scene, and an animation in which the left arm waves."""
    gltf = library()
    made: GLTF2 = gltf.GLTF2(asset=gltf.Asset(version="2.0"), scene=0, scenes=[gltf.Scene(nodes=[0])])
    limbs = [gltf.Node(name=name, translation=at.tolist()) for name, at in zip(NAMES, joints(), strict=True)]
    made.nodes = [gltf.Node(name="Body", children=[*range(1, 1 + len(limbs))]), *limbs]
    buffer = Buffer(made)
    turns = Rotation.from_rotvec(np.radians([[0, 0, angle] for angle in WAVE])).as_quat()
    sampler = gltf.AnimationSampler(
        input=buffer.add(np.linspace(0, 2, len(turns)).astype("<f4"), bounded=True),
        output=buffer.add(turns.astype("<f4")),
    )
    target = gltf.AnimationChannelTarget(node=1 + NAMES.index("Arm.L"), path="rotation")
    made.animations = [
        gltf.Animation(name="Wave", samplers=[sampler], channels=[gltf.AnimationChannel(sampler=0, target=target)])
    ]
    buffer.finish()
    return made


def posed(points: Floats, bend: float) -> Floats:
    """Bend what lies beyond the body around arcs: arms upwards, legs forwards, the tail down."""
    points = points.copy()
    if bend == 0:
        return points
    for along, towards, sign in ((0, 2, 1), (0, 2, -1), (2, 1, -1), (1, 2, 1)):
        beyond = sign * points[:, along] - BODY
        moved_here = beyond > 0
        # The limb's middle line becomes an arc of constant curvature; sections stay plane.
        middle = points[moved_here, towards].mean()
        radius = beyond.max() / bend
        angle = beyond[moved_here] / radius
        across = points[moved_here, towards] - middle
        points[moved_here, along] = sign * (BODY + (radius - across) * np.sin(angle))
        points[moved_here, towards] = middle + radius - (radius - across) * np.cos(angle)
    return points
