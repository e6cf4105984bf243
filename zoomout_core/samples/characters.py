# SPDX-License-Identifier: GPL-3.0-or-later
"""The creature as a game character, a scan of it, and their files."""

from __future__ import annotations

import os
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from zoomout_core.arrays import Floats
from zoomout_core.assets.asset import COLOR, UV, Asset, Material, Skin, material_numbers
from zoomout_core.assets.files import write_asset
from zoomout_core.colors import place_colors
from zoomout_core.drawing import encode_png
from zoomout_core.mesh.affine_maps import blend_matrices, transform_points
from zoomout_core.mesh.decimation import decimate
from zoomout_core.mesh.formats.files import read_surface
from zoomout_core.mesh.formats.gltf_buffer import Buffer
from zoomout_core.mesh.formats.gltf_document import Document, library
from zoomout_core.mesh.surface import Surface
from zoomout_core.mesh.triangles import unit_vectors
from zoomout_core.mesh.voxel_remesh import voxel_remesh
from zoomout_core.runtime.outputs import OutputError, atomic_write, make_folder
from zoomout_core.samples.creatures import FLAT, LIMBS, NAMES, Creature, at_rest, creature, limb_weights, true_vertex
from zoomout_core.transfer.attribute import Attribute, Domain, Kind

if TYPE_CHECKING:
    from pygltflib import GLTF2

# From the creature's frame to glTF's, where y points up.
UPRIGHT = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
# Pose of the scan: rotations of its limbs in glTF's frame, in degrees about x, y and z.
STANCE: Mapping[str, tuple[float, float, float]] = {
    "Arm.L": (0, 0, -45),
    "Arm.R": (0, 35, -30),
    "Leg.L": (-35, 0, 0),
    "Leg.R": (25, 0, 0),
    "Head": (0, 25, 0),
    "Tail": (-30, 0, 0),
}
# Vertices, and voxels along the longest extent, of the remeshed body.
FINE, VOXELS = 20000, 120
# Rotations of the waving arm, in degrees.
WAVE = 0.0, 50.0, 0.0, 50.0, 0.0
# Pixels and squares along a side of the texture; the truth lists every n-th vertex of the scan.
TEXELS, SQUARES, PAIRS_EVERY = 128, 8, 10


def body(count: int = 5000, seed: int = 0) -> Creature:
    """The creature at rest in glTF's frame (y points up), with triangles of about equal size, as from a remesher.

    It has approximately `count` vertices; the seed is that of the triangles.
    """
    turn = Rotation.from_rotvec(seed * np.array([0.3, 0.5, 0.7]))
    fine = creature(FINE).surface
    vertices, triangles = voxel_remesh(turn.apply(fine.vertices), fine.triangles, VOXELS)
    vertices, triangles = decimate(vertices, triangles, count)[:2]
    where = unit_vectors(turn.apply(vertices, inverse=True) / FLAT)
    return Creature(Surface(at_rest(where) @ UPRIGHT.T, triangles), where)


def character(count: int = 5000) -> Asset:
    """A creature as a game character: texture coordinates, a texture, two materials, colours, joints, an animation.

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
    """The same creature as if scanned: in another pose, with other triangles, by their seed, in glTF's frame."""
    made = body(count, seed)
    return Creature(in_stance(made), made.directions)


def in_stance(made: Creature) -> Surface:
    """Pose a creature, at rest in glTF's frame, like the scan."""
    surface = made.surface
    transforms = np.tile(np.eye(4)[:3], (1 + len(NAMES), 1, 1))
    for number, (name, joint) in enumerate(zip(NAMES, joints(), strict=True), start=1):
        turn = Rotation.from_euler("xyz", STANCE[name], degrees=True).as_matrix()
        transforms[number] = np.column_stack([turn, joint - turn @ joint])
    matrices = blend_matrices(transforms, csr_array(limb_weights(made.directions)))
    return surface.with_vertices(transform_points(matrices, surface.vertices))


def write_samples(folder: str | PathLike[str]) -> tuple[Path, ...]:
    """Write `character.glb`, `scan.ply` and `truth.txt`, pairs of vertices that correspond.

    Returns:
        The paths of the three files.

    Raises:
        OutputError: they cannot be written, or one of them exists.
        ImportError: the packages of the extra `cli` are not installed.
    """
    place = Path(folder)
    files = tuple(place / name for name in ("character.glb", "scan.ply", "truth.txt"))
    there = next((file for file in files if os.path.lexists(file)), None)
    if there is not None:
        raise OutputError(f"{there} exists: remove it, or choose another folder.")
    make_folder(place)
    made, scanned = body(), scan()
    write_asset(character(), files[0])
    write_asset(Asset(scanned.surface), files[1])
    # Each program numbers the vertices of a glTF file in its own way.
    number = np.asarray(cKDTree(read_surface(files[0]).vertices).query(made.surface.vertices)[1])
    some = np.arange(0, len(scanned.directions), PAIRS_EVERY)
    pairs = np.column_stack([number[true_vertex(made, scanned)[some]], some])
    with atomic_write(files[2]) as part:
        part.write_text("".join(f"{source} {target}\n" for source, target in pairs), encoding="utf-8")
    return files


def joints() -> Floats:
    """(limbs, 3) the joint of each limb, in glTF's frame."""
    return LIMBS / np.linalg.norm(LIMBS, axis=1, keepdims=True) * FLAT @ UPRIGHT.T


def checker() -> bytes:
    """A PNG file of a checkerboard whose squares differ in hue."""
    place = np.arange(TEXELS) * SQUARES // TEXELS
    shade = np.where((place[:, None] + place) % 2, 1.0, 0.7)
    hue = np.stack(np.broadcast_arrays(place[:, None], SQUARES - 1 - place, SQUARES // 2), axis=-1) / (SQUARES - 1)
    pixels = (255 * shade[:, :, None] * (0.4 + 0.6 * hue)).astype(np.uint8)
    return encode_png(pixels)


def _texture_coordinates(made: Creature) -> Floats:
    """(c, 2) longitude and latitude of the corners' directions, with a seam at the back."""
    # Contiguous, so that the last bits do not depend on the place of the arrays in memory, as in `geometry/shot.py`.
    x, y, z = np.ascontiguousarray(made.directions[made.surface.corner_vertex].T)
    across = (np.arctan2(x, -y) / np.pi + 1) / 2
    of_face = across.reshape(-1, 3)
    of_face += (of_face < 0.5) & (np.ptp(of_face, axis=1, keepdims=True) > 0.5)
    return np.column_stack([of_face.ravel(), 1 - np.arccos(z) / np.pi])


def _skin(surface: Surface, where: Floats) -> Skin:
    """The joints and weights of a creature at rest."""
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
