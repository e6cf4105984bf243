# SPDX-License-Identifier: GPL-3.0-or-later
"""The options of a match, the same for Python, the command line, Blender and MeshLab."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from zoomout_core.arrays import check_count

if TYPE_CHECKING:
    from zoomout_core.maps.surface_map import SurfaceMap
    from zoomout_core.matching.constraints import Landmarks, Regions

Initial: TypeAlias = Literal["auto", "landmarks", "proximity", "given"]

# Whether shapes may be parts of each other.
PARTIAL = ("auto", "off")
# Minimum sizes of the final functional map, and of a proxy, in vertices.
SMALLEST_FINAL = 4
SMALLEST_PROXY = 500
# Defaults of `match_by_proximity`: over the square root of the source's area, and in degrees. The paper has a
# twentieth of the bounding box's diagonal, which is about this for a human figure, and the same angle. On clothes 0.005
# to 0.04 above a body, all distances that reach them were as good, and wider angles worse.
MAX_DISTANCE = 0.08
MAX_ANGLE = 30.0


@dataclass(frozen=True, eq=False, kw_only=True)
class MatchOptions:
    """Options of a match. They are validated at once, except against the surfaces.

    Attributes:
        initial: the initial map. "auto": from the shapes alone. "landmarks": from the given pairs. "proximity": from
            nearest points, if the two overlap in space. "given": from `initial_map`.
        landmarks: a tuple (places on the source, corresponding places on the target). Each is vertex numbers (m,), or
            points (m, 3) on the surface, in its own frame and unit. A list of pairs is refused.
        initial_map: a source vertex for each target vertex (n_t,), a SurfaceMap, or a functional map
            (k_t, k_s) between `eigenbasis(source)` and `eigenbasis(target)`. With initial="auto" it is evidence, not
            only the initial map.
        k_final: size of the final functional map, at least 4; smaller on meshes with fewer vertices.
        step: growth of the functional map in a round; smaller steps take more rounds.
        samples: number of farthest-point samples of the iterations.
        seed: of the eigensolver.
        proxy_vertices: approximate number of vertices, at least 500, to which larger meshes are decimated; "auto": an
            eighth of the mesh's, from 4,000 to 6,000; None to match full meshes, which takes many times as long and
            gains little.
        common_axes: (3,) or (a, 3) directions that both surfaces share, such as the up axis, as evidence.
        upright: shapes usually stand upright in their files, with y or z up, which is weak evidence; False where one of
            them may be rotated.
        regions: pairs of source vertices and target vertices that correspond as sets, such as vertex groups of the same
            name. They are evidence, constrain the map, and decide which loose parts are paired.
        partial: "auto": if the map of two whole shapes is uncertain, and a part may be missing at a border of either,
            one is also tried as a part of the other. This requires initial="auto". "off": both shapes are whole.
        exact_landmarks: deform the final map so that each landmark maps to its partner; otherwise landmarks attract it.

    Raises:
        ValueError: options contradict each other.

    Example:
        >>> zo.MatchOptions(k_final=200).initial
        'auto'
    """

    initial: Initial = "auto"
    landmarks: Landmarks | None = None
    initial_map: SurfaceMap | ArrayLike | None = None
    k_final: int = 120
    step: int = 20
    samples: int = 1000
    seed: int = 0
    proxy_vertices: int | Literal["auto"] | None = "auto"
    common_axes: ArrayLike | None = None
    upright: bool = True
    regions: Regions | None = None
    exact_landmarks: bool = False
    partial: Literal["auto", "off"] = "auto"

    def __post_init__(self) -> None:
        _check_start(self.initial, self.landmarks, self.initial_map)
        _check_pairs(self.landmarks, self.regions)
        check_count("seed", self.seed, 0)
        check_sizes(self.k_final, self.step, self.samples, self.proxy_vertices)
        if self.partial not in PARTIAL:
            raise ValueError(f"partial is {self.partial!r}: choose one of {', '.join(PARTIAL)}.")
        if self.exact_landmarks and self.landmarks is None:
            raise ValueError("exact_landmarks needs `landmarks`: give them, or leave it out.")


def _check_start(initial: str, landmarks: Landmarks | None, initial_map: object) -> None:
    known = ("auto", "landmarks", "proximity", "given")
    if initial not in known:
        raise ValueError(f"initial is {initial!r}: choose one of {', '.join(known)}.")
    if initial == "landmarks" and landmarks is None:
        raise ValueError("A start from landmarks needs `landmarks`: source vertices and target vertices.")
    if initial == "given" and initial_map is None:
        raise ValueError("A given start needs `initial_map`: a vertex map, a SurfaceMap or a functional map.")
    if initial in ("landmarks", "proximity") and initial_map is not None:
        raise ValueError(f"`initial_map` is not used by initial={initial!r}: leave one of them out.")
    if initial in ("proximity", "given") and landmarks is not None:
        raise ValueError(f"Landmarks are not used by initial={initial!r}: leave them out, or use initial='landmarks'.")


def _check_pairs(landmarks: object, regions: object) -> None:
    if _are_pairs(landmarks):
        raise ValueError(
            "landmarks looks like a list of pairs: give a tuple (source vertices, target vertices), such as "
            "([12, 40], [7, 33]) for the pairs 12-7 and 40-33."
        )
    if landmarks is not None and not (isinstance(landmarks, Sequence | np.ndarray) and len(landmarks) == 2):
        raise TypeError(
            f"landmarks is {landmarks!r:.80}: give a pair, places on the source and places on the target that "
            "correspond to them."
        )
    if regions is not None and not isinstance(regions, Iterable):
        raise TypeError(f"regions is {regions!r:.80}: give pairs of source vertices and target vertices.")


def _are_pairs(landmarks: object) -> bool:
    """Whether landmarks are a list of pairs instead of a tuple of two lists.

    Two pairs look like two lists of two landmarks, so the latter must be in a tuple.
    """
    if not isinstance(landmarks, list | tuple) and not (isinstance(landmarks, np.ndarray) and landmarks.ndim):
        return False
    of_two = all(isinstance(each, Sequence | np.ndarray) and len(each) == 2 for each in landmarks)
    return len(landmarks) > 0 and of_two and not (len(landmarks) == 2 and isinstance(landmarks, tuple))


def check_sizes(k_final: int, step: int, samples: int, proxy_vertices: int | Literal["auto"] | None) -> None:
    """Raise a ValueError if an option of a match is not a whole number, or below its minimum."""
    for name, value, least in (
        ("k_final", k_final, SMALLEST_FINAL),
        ("step", step, 1),
        ("samples", samples, 1),
        ("proxy_vertices", None if proxy_vertices == "auto" else proxy_vertices, SMALLEST_PROXY),
    ):
        if value is not None or name != "proxy_vertices":
            check_count(name, value, least)
