"""A creature with five unlike limbs, whose poses and triangles vary while every vertex keeps its rest position.

Each limb leaves the body at a point, in a direction, and can be bent into an arc, which hardly stretches it.
Two meshes of it, remeshed on their own and posed differently, so correspond by their rest positions.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pymeshlab
from PIL import Image

# (from, to, radius) of the capsules; the first is the body.
CAPSULES = np.array(
    [
        [-0.5, 0, 0, 0.6, 0, 0, 0.42],
        [0.8, 0.1, 0.15, 1.7, 0.5, 0.6, 0.26],
        [0.4, 0.3, 0, 0.7, 2.0, 0.1, 0.17],
        [0.2, -0.3, 0, 0.4, -1.5, -0.1, 0.2],
        [-0.6, 0.2, 0, -1.6, 1.4, 0.0, 0.22],
        [-0.6, -0.2, 0.1, -2.2, -0.7, 0.3, 0.15],
    ]
)
# How the pose bends each limb: the curvature, towards +z.
STRAIGHT = np.zeros(5)
SOURCE_POSE = np.array([0.5, 0.9, -0.6, 0.3, 0.7])
TARGET_POSE = np.array([-0.4, -0.8, 1.1, -0.7, -0.6])


@dataclass(frozen=True, eq=False)
class Creature:
    """A posed mesh.

    Attributes:
        rest: (n, 3) rest positions of the vertices.
        vertices: (n, 3) posed positions.
        faces: (m, 3) vertex numbers.
    """

    rest: np.ndarray
    vertices: np.ndarray
    faces: np.ndarray

    def mesh(self, **components: np.ndarray) -> pymeshlab.Mesh:
        return pymeshlab.Mesh(self.vertices, self.faces, **components)


def _implicit_surface(voxel: float) -> pymeshlab.MeshSet:
    terms = []
    for ax, ay, az, bx, by, bz, radius in CAPSULES:
        dx, dy, dz = bx - ax, by - ay, bz - az
        along = f"min(1, max(0, ((x-{ax})*{dx} + (y-{ay})*{dy} + (z-{az})*{dz}) / {dx**2 + dy**2 + dz**2}))"
        px, py, pz = (f"x-{ax}-{dx}*{along}", f"y-{ay}-{dy}*{along}", f"z-{az}-{dz}*{along}")
        terms.append(f"exp(-16*(sqrt(({px})^2 + ({py})^2 + ({pz})^2) - {radius}))".replace("--", "+"))
    ms = pymeshlab.MeshSet()
    ms.apply_filter(
        "create_implicit_surface",
        voxelsize=voxel,
        minx=-2.6,
        miny=-2.0,
        minz=-0.8,
        maxx=2.2,
        maxy=2.4,
        maxz=1.1,
        expr="-(" + "+".join(terms) + ")+1",
    )
    return ms


def creature(edge: float, pose: np.ndarray) -> Creature:
    """The creature with triangles of an edge length, in a pose."""
    ms = _implicit_surface(0.08)
    ms.apply_filter("meshing_isotropic_explicit_remeshing", targetlen=pymeshlab.PureValue(edge), iterations=6)
    mesh = ms.current_mesh()
    rest = mesh.vertex_matrix()
    return Creature(rest, posed(rest, pose), mesh.face_matrix())


def posed(rest: np.ndarray, curvature: np.ndarray) -> np.ndarray:
    """(n, 3) where a pose brings points at rest."""
    start, end, radius = CAPSULES[:, :3], CAPSULES[:, 3:6], CAPSULES[:, 6]
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
        angle = bend * t
        radius_of_arc = 1 / bend - height
        result[part == limb] = (
            start[limb]
            + side
            + (before + radius_of_arc * np.sin(angle))[:, None] * forward
            + (1 / bend - radius_of_arc * np.cos(angle))[:, None] * up
        )
    return result


# The texture map has a chart above and one below this height, and a texture in front of and one behind x = 0.
SEAM_HEIGHT = 0.05


def chart_of(rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether points belong to the upper chart, and the number of their texture: 0 in front."""
    return rest[:, 2] > SEAM_HEIGHT, np.where(rest[:, 0] > 0, 0, 1)


def coordinates(rest: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """(n, 2) texture coordinates: the upper chart fills the right half, u > 0.5."""
    return np.column_stack([(rest[:, 0] + 2.5) / 10 + np.where(upper, 0.5, 0), (rest[:, 1] + 2) / 5])


def rest_of(uv: np.ndarray) -> np.ndarray:
    """(n, 2) x and y at rest of texture coordinates."""
    return np.column_stack([10 * (uv[:, 0] % 0.5) - 2.5, 5 * uv[:, 1] - 2])


def write_textured_obj(folder: Path, made: Creature) -> None:
    """creature.obj, with its material file and the textures `front.bmp` and `back.png`."""
    random = np.random.default_rng(0)
    for name, width in (("front.bmp", 16), ("back.png", 32)):
        Image.fromarray(random.integers(0, 255, (16, width, 3), dtype=np.uint8)).save(folder / name)
    materials = ["newmtl m0", "map_Kd front.bmp", "newmtl m1", "map_Kd back.png"]
    (folder / "creature.mtl").write_text("\n".join(materials))
    upper, texture = chart_of(made.rest[made.faces].mean(axis=1))
    uv = coordinates(made.rest[made.faces.ravel()], np.repeat(upper, 3))
    lines = ["mtllib creature.mtl"]
    lines += ["v {:.17g} {:.17g} {:.17g}".format(*vertex) for vertex in made.vertices]
    lines += ["vt {:.17g} {:.17g}".format(*pair) for pair in uv]
    for number, face in enumerate(made.faces):
        lines.append(f"usemtl m{texture[number]}")
        lines.append("f " + " ".join(f"{vertex + 1}/{3 * number + i + 1}" for i, vertex in enumerate(face)))
    (folder / "creature.obj").write_text("\n".join(lines))
