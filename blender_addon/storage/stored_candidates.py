# SPDX-License-Identifier: GPL-3.0-or-later
"""The ranked candidates of a match, stored with it on the target's mesh as a custom property.

Each candidate has its probability, and the position colours of the source points that some target vertices map to. The
colours are for a thumbnail, and identify the same candidate after matching again.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from functools import lru_cache

import numpy as np
from bpy.types import Mesh

from zoomout_core.arrays import Bytes, Floats, Integers

from ..mesh_data.arrays import from_text, to_text
from .stored_json import Kind, is_of_kind

PROPERTY = "zoomout_candidates"
# The entries of a list.
ENTRIES: dict[str, Kind] = {
    "key": str,
    "chosen": int,
    "vertices": str,
    "points": str,
    "box": [(int, float), (int, float), (int, float)],
    "candidates": [
        {"number": int, "certainty": (int, float), "mirrored": bool, "colors": str, "difference": (None, str)}
    ],
}


@dataclass(frozen=True, eq=False)
class ListedCandidate:
    """A candidate; the field names are the keys of the stored JSON.

    Attributes:
        number: index of the candidate in the `MatchResult`.
        certainty: probability that it is correct, in [0, 1].
        mirrored: whether it reverses orientation.
        colors: (s, 3) position colours of the source points that the sampled vertices map to, 0 to 255.
        difference: how it differs from the most likely one, see `matching.candidate_differences`; empty in older files.
    """

    number: int
    certainty: float
    mirrored: bool
    colors: Bytes
    difference: str = ""


@dataclass(frozen=True, eq=False)
class CandidateList:
    """The candidates of a match; the field names are the keys of the stored JSON.

    Attributes:
        key: hash that identifies the list.
        chosen: index of the candidate in use.
        vertices: (s,) sampled vertices of the target.
        points: (s, 3) their positions in world space, for a thumbnail.
        box: (3,) edge lengths of the source's bounding box, the scale of position colours.
        candidates: the candidates by decreasing probability.
    """

    key: str
    chosen: int
    vertices: Integers
    points: Floats
    box: Floats
    candidates: tuple[ListedCandidate, ...]


def write(mesh: Mesh, listing: CandidateList) -> None:
    """Store a list on the target's mesh; it replaces an earlier one."""
    content = asdict(listing) | {
        "vertices": to_text(listing.vertices, np.int32),
        "points": to_text(listing.points, np.float32),
        "box": listing.box.tolist(),
        "candidates": [asdict(one) | {"colors": to_text(one.colors, np.uint8)} for one in listing.candidates],
    }
    mesh[PROPERTY] = json.dumps(content)


def read(mesh: Mesh) -> CandidateList | None:
    """The list stored on a mesh, or None if there is none, or it is damaged."""
    text = mesh.get(PROPERTY)
    try:
        return parse(text) if isinstance(text, str) else None
    except (ValueError, KeyError, TypeError, RecursionError):  # damaged
        return None


def remove(mesh: Mesh) -> None:
    """Remove the list from a mesh, if it has one."""
    if PROPERTY in mesh:
        del mesh[PROPERTY]


@lru_cache(maxsize=8)
def parse(text: str) -> CandidateList:
    """The list from a JSON text; cached, since panels read it at each redraw.

    Raises:
        ValueError: it is damaged.
    """
    stored = json.loads(text)
    if not is_of_kind(stored, ENTRIES) or not 0 <= stored["chosen"] < len(stored["candidates"]):
        raise ValueError("This is not a list of candidates.")
    return CandidateList(
        stored["key"],
        stored["chosen"],
        from_text(stored["vertices"], np.int32),
        from_text(stored["points"], np.float32, 3),
        np.array(stored["box"]),
        tuple(
            ListedCandidate(**one | {"colors": from_text(one["colors"], np.uint8, 3)}) for one in stored["candidates"]
        ),
    )
