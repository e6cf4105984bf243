# SPDX-License-Identifier: GPL-3.0-or-later
"""Sample meshes for the filters: a textured character, its retopology in another pose, scans, and the truth.

A smooth union of capsules is made by MeshLab's own filters. Each limb starts at a point of the body, in a
direction, and can be bent into an arc with little stretch. Two meshes of a body, remeshed independently and posed
differently, correspond by their rest positions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from meshlab_filter.files import new_mesh_set, save_mesh
from meshlab_filter.project import ProjectMesh, write_project
from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.runtime.outputs import OutputError, check_output, make_folder
from zoomout_core.samples.arcs import bend_along_arc

if TYPE_CHECKING:
    from PIL.Image import Image
    from pymeshlab import Mesh

# (start, end, radius) of the capsules; the first is the body. Five different limbs.
CHARACTER = np.array(
    [
        [-0.5, 0, 0, 0.6, 0, 0, 0.42],
        [0.8, 0.1, 0.15, 1.7, 0.5, 0.6, 0.26],
        [0.4, 0.3, 0, 0.7, 2.0, 0.1, 0.17],
        [0.2, -0.3, 0, 0.4, -1.5, -0.1, 0.2],
        [-0.6, 0.2, 0, -1.6, 1.4, 0.0, 0.22],
        [-0.6, -0.2, 0.1, -2.2, -0.7, 0.3, 0.15],
    ]
)
# Symmetric about y = 0: a head, a tail, two arms and two legs.
SYMMETRIC = np.array(
    [
        [-0.5, 0, 0, 0.6, 0, 0, 0.42],
        [0.8, 0, 0.15, 1.5, 0, 0.6, 0.28],
        [-0.7, 0, 0.1, -2.0, 0, 0.3, 0.14],
        [0.45, 0.3, 0, 0.8, 1.7, 0, 0.17],
        [0.45, -0.3, 0, 0.8, -1.7, 0, 0.17],
        [-0.4, 0.25, 0, -1.2, 1.5, 0, 0.21],
        [-0.4, -0.25, 0, -1.2, -1.5, 0, 0.21],
    ]
)
# A pose: the curvature of each limb, towards +z.
CHARACTER_POSE = np.array([0.5, 0.9, -0.6, 0.3, 0.7])
OTHER_POSE = np.array([-0.4, -0.8, 1.1, -0.7, -0.6])
SCAN_POSE = np.array([0.2, 0.5, 0.6, -0.5, 0.3, -0.4])

# Length of edges, in the unit of the bodies, whose length is 4.
CHARACTER_EDGE, RETOPOLOGY_EDGE, SCAN_EDGE = 0.08, 0.1, 0.1
# Standard deviation of a scan's noise; centre and radius of its hole at rest.
NOISE = 0.01
HOLE = np.array([0.1, 0, 0.42]), 0.2
# Offset of the retopology from the character in the project.
ASIDE = 5.0

# The UV map has one chart above and one below this height, and one texture in front of and one behind x = 0.
SEAM_HEIGHT = 0.05
TEXTURES = ("front.png", "back.png")
TEXELS, SQUARES = 512, 32


@dataclass(frozen=True, eq=False)
class Sample:
    """A posed mesh.

    Attributes:
        rest: (n, 3) rest positions of the vertices.
        vertices: (n, 3) posed positions.
        faces: (m, 3) vertex indices.
    """

    rest: Floats
    vertices: Floats
    faces: Integers

    def mesh(self, **components: Any) -> Mesh:
        """The pymeshlab mesh, with further components."""
        import pymeshlab

        return pymeshlab.Mesh(self.vertices, self.faces, **components)


def sample(capsules: Floats, edge: float, pose: Floats) -> Sample:
    """Build a posed body with triangles of a given edge length.

    Args:
        capsules: (c, 7) start, end and radius; the first is the body, the others are limbs.
        edge: length of edges in the same unit.
        pose: (c - 1,) the curvature of each limb.
    """
    import pymeshlab

    ms = pymeshlab.MeshSet()
    ms.add_mesh(pymeshlab.Mesh(*_melted(tuple(map(tuple, capsules.tolist())))))
    ms.apply_filter("meshing_isotropic_explicit_remeshing", targetlen=pymeshlab.PureValue(edge), iterations=6)
    mesh = ms.current_mesh()
    rest = mesh.vertex_matrix()
    return Sample(rest, posed(capsules, rest, pose), mesh.face_matrix())


@cache
def _melted(capsules: tuple[tuple[float, ...], ...]) -> tuple[Floats, Integers]:
    """The vertices and faces of a surface around the capsules, with small triangles."""
    import pymeshlab

    terms = []
    for ax, ay, az, bx, by, bz, radius in capsules:
        dx, dy, dz = bx - ax, by - ay, bz - az
        along = f"min(1, max(0, ((x-{ax})*{dx} + (y-{ay})*{dy} + (z-{az})*{dz}) / {dx**2 + dy**2 + dz**2}))"
        px, py, pz = (f"x-{ax}-{dx}*{along}", f"y-{ay}-{dy}*{along}", f"z-{az}-{dz}*{along}")
        terms.append(f"exp(-16*(sqrt(({px})^2 + ({py})^2 + ({pz})^2) - {radius}))".replace("--", "+"))
    ms = pymeshlab.MeshSet()
    ms.apply_filter(
        "create_implicit_surface",
        voxelsize=0.08,
        minx=-2.6,
        miny=-2.0,
        minz=-0.8,
        maxx=2.2,
        maxy=2.4,
        maxz=1.1,
        expr="-(" + "+".join(terms) + ")+1",
    )
    return ms.current_mesh().vertex_matrix(), ms.current_mesh().face_matrix()


def posed(capsules: Floats, rest: Floats, curvature: Floats) -> Floats:
    """(n, 3) posed positions of points at rest."""
    start, end, radius = capsules[:, :3], capsules[:, 3:6], capsules[:, 6]
    along = np.einsum("ncx,cx->nc", rest[:, None] - start, end - start) / ((end - start) ** 2).sum(axis=1)
    foot = start + np.clip(along, 0, 1)[..., None] * (end - start)
    part = np.argmin(np.linalg.norm(rest[:, None] - foot, axis=2) - radius, axis=1)
    result = rest.copy()
    for limb, bend in enumerate(curvature, start=1):
        if bend == 0:
            continue
        length = np.linalg.norm(end[limb] - start[limb])
        forward = (end[limb] - start[limb]) / length
        up = np.array([0, 0, 1.0]) - forward[2] * forward
        up /= np.linalg.norm(up)
        points = rest[part == limb] - start[limb]
        t, height = points @ forward, points @ up
        side = points - t[:, None] * forward - height[:, None] * up
        t = np.where(t > 0.2 * length, t - 0.2 * length, 0)  # the root stays with the body
        before = points @ forward - t
        along_arc, across = bend_along_arc(height, bend * t, 1 / bend)
        result[part == limb] = start[limb] + side + (before + along_arc)[:, None] * forward + across[:, None] * up
    return result


def scanned(made: Sample) -> Sample:
    """Add noise of a tenth of an edge, and a hole on the back."""
    noise = np.random.default_rng(0).normal(scale=NOISE, size=made.vertices.shape)
    middle, radius = HOLE
    keep = np.linalg.norm(made.rest[made.faces].mean(axis=1) - middle, axis=1) > radius
    used, faces = np.unique(made.faces[keep], return_inverse=True)
    return Sample(made.rest[used], (made.vertices + noise)[used], faces.reshape(-1, 3))


def chart_of(rest: Floats) -> tuple[Booleans, Integers]:
    """Whether points belong to the upper chart, and the index of their texture: 0 in front."""
    return rest[:, 2] > SEAM_HEIGHT, np.where(rest[:, 0] > 0, 0, 1)


def coordinates(rest: Floats, upper: Booleans) -> Floats:
    """(n, 2) texture coordinates: the upper chart fills the right half, u > 0.5."""
    return np.column_stack([(rest[:, 0] + 2.5) / 10 + np.where(upper, 0.5, 0), (rest[:, 1] + 2) / 5])


def write_obj(path: Path, made: Sample, textures: tuple[str, ...] = TEXTURES) -> None:
    """Write an OBJ file of a character, and the .mtl file with its textures."""
    materials = [f"newmtl m{number}\nmap_Kd {name}\n" for number, name in enumerate(textures)]
    path.with_suffix(".mtl").write_text("".join(materials), encoding="utf-8")
    upper, texture = chart_of(made.rest[made.faces].mean(axis=1))
    uv = coordinates(made.rest[made.faces.ravel()], np.repeat(upper, 3))
    lines = [f"mtllib {path.stem}.mtl"]
    lines += ["v {:.17g} {:.17g} {:.17g}".format(*vertex) for vertex in made.vertices]
    lines += ["vt {:.17g} {:.17g}".format(*pair) for pair in uv]
    for number, face in enumerate(made.faces):
        lines.append(f"usemtl m{texture[number]}")
        lines.append("f " + " ".join(f"{vertex + 1}/{3 * number + i + 1}" for i, vertex in enumerate(face)))
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")


def checkered(dark: tuple[int, int, int]) -> Image:
    """A checker texture of one constant colour and one that varies in both directions."""
    from PIL import Image

    row, column = np.indices((TEXELS, TEXELS))
    u, v = column / TEXELS, 1 - row / TEXELS
    light = np.stack([255 - 150 * u, 120 + 130 * v, 255 - 200 * v], axis=-1)
    odd = (row // (TEXELS // SQUARES) + column // (TEXELS // SQUARES)) % 2 == 1
    return Image.fromarray(np.where(odd[..., None], dark, light).astype(np.uint8))


def character() -> Sample:
    """The textured character."""
    return sample(CHARACTER, CHARACTER_EDGE, CHARACTER_POSE)


def retopology() -> Sample:
    """The character in another pose, with other triangles, noise and a hole."""
    return scanned(sample(CHARACTER, RETOPOLOGY_EDGE, OTHER_POSE))


def scan() -> Sample:
    """A symmetric body in an asymmetric pose."""
    return sample(SYMMETRIC, SCAN_EDGE, SCAN_POSE)


def write_samples(folder: Path) -> list[Path]:
    """Write the sample meshes of the guide's recipes, and return their files.

    Raises:
        OutputError: the folder cannot be written to, or is not empty.
        ImportError: pymeshlab is not installed.
    """
    new_mesh_set()
    check_output(folder / "character.obj" if folder.is_dir() else folder)
    if folder.is_dir() and any(folder.iterdir()):
        raise OutputError(f"{folder} is not empty: give a new folder.")
    make_folder(folder / "scans")
    source, target = character(), retopology()
    write_obj(folder / "character.obj", source)
    for name, dark in zip(TEXTURES, ((120, 40, 60), (40, 60, 120)), strict=True):
        checkered(dark).save(folder / name)
    made = {
        "retopology": target,
        "another": sample(CHARACTER, 0.12, -CHARACTER_POSE),
        "scans/first": target,
        "scans/second": sample(CHARACTER, 0.11, OTHER_POSE[::-1]),
        "scan": scan(),
    }
    for name, one in made.items():
        ms = new_mesh_set()
        ms.add_mesh(one.mesh())
        save_mesh(ms, folder / f"{name}.ply")
    aside = np.eye(4)
    aside[0, 3] = ASIDE
    meshes = [ProjectMesh("character", folder / "character.obj", np.eye(4))]
    write_project(folder / "project.mlp", [*meshes, ProjectMesh("retopology", folder / "retopology.ply", aside)])
    # Two vertices correspond if the same vertex of the character is nearest to both at rest.
    true = np.linalg.norm(source.rest[None] - target.rest[:, None], axis=2).argmin(axis=1)
    np.savez_compressed(folder / "template_vertex.npz", character=np.arange(len(source.rest)), retopology=true)
    names = ("character.obj", *(f"{name}.ply" for name in made), "project.mlp", "template_vertex.npz")
    return [folder / name for name in names]
