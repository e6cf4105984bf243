"""A match, kept on the target's mesh: three attributes, and a custom property that says what they belong to.

Triangles are numbered like Blender's `loop_triangles` of the source, its own where the modifiers keep its faces,
else those that they leave, and barycentric coordinates follow their corners; those of a mirrored object count in
the opposite order, see `mesh_data`. Where a target lies on several objects, their triangles follow each other.
Where the modifiers make faces of their own, and a later pose folds one of these so that Blender divides it another
way, points move within that face.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from bpy.types import Mesh

import zoomout_core as zo
from zoomout_core.transfer import Attribute, Domain, Kind

from ..mesh_data import MATCH_ATTRIBUTES, Fingerprint, Layer, ObjectPair, Role, read_layer, write_layer

TRIANGLE, BARYCENTRIC, CONFIDENCE = MATCH_ATTRIBUTES
PROPERTY = "zoomout_match"
# Among the settings that are kept: a fingerprint of the landmarks that were weighed.
LANDMARKS = "landmarks_fingerprint"
# Vertices below this confidence are counted in reports.
LOW_CONFIDENCE = 0.5


@dataclass(frozen=True, eq=False)
class StoredMatch:
    """What transfer needs of a match.

    Attributes:
        surface_map: for each vertex of the target a point on the source, or on several, one after another.
        confidence: (n_t,) how far to trust it, in [0, 1].
        notes: sentences for the user.
        settings: what it was made with, by the names of the arguments of `match_objects`, as far as known.
        others: names of the objects that the target lies on besides its source.
    """

    surface_map: zo.SurfaceMap
    confidence: np.ndarray
    notes: tuple[str, ...]
    settings: dict[str, Any] = field(default_factory=dict)
    others: tuple[str, ...] = ()


Match: TypeAlias = zo.MatchResult | zo.ProximityMatch | StoredMatch


def write(mesh: Mesh, match: Match, pair: ObjectPair, settings: Mapping[str, Any]) -> None:
    """Keep a match on the target's mesh, in place of an earlier one.

    Args:
        mesh: the target's.
        match: the match.
        pair: its two objects.
        settings: what it was made with; of these, those that are a number or a word are kept.
    """
    surface_map, (source, *further), target = match.surface_map, pair.source_fingerprints, pair.target_fingerprint
    for name, kind, data_type, values in (
        (TRIANGLE, Kind.LABEL, "INT", surface_map.triangle),
        (BARYCENTRIC, Kind.VECTOR, "FLOAT_VECTOR", surface_map.barycentric),
        (CONFIDENCE, Kind.SCALAR, "FLOAT", match.confidence),
    ):
        write_layer(mesh, Layer(Attribute(name, Domain.POINT, kind, values), Role.GENERIC, data_type))
    mesh[PROPERTY] = json.dumps(
        {
            "source": source.name,
            "source_fingerprint": source.digest,
            "target_fingerprint": target.digest,
            # What can be compared in passing, see `preflight.stale`.
            "content": {"source": source.content, "target": target.content},
            "size": {"source": source.size, "target": target.size},
            "mirrored": {"source": source.mirrored, "target": target.mirrored},
            "others": [_described(source) for source in further],
            "vertices": len(match.confidence),
            "low_confidence": low_confidence(match.confidence),
            "notes": match.notes,
            "settings": {name: value for name, value in settings.items() if isinstance(value, (int, float, str))},
        }
    )
    mesh.update()


def read(mesh: Mesh, pair: ObjectPair) -> StoredMatch | None:
    """The match of this pair that is kept on the target's mesh, or None if there is none, or one with another source.

    Raises:
        MeshError: the source or the target was edited since.
    """
    kept = description(mesh)
    if kept is None:
        return None
    digests = [kept["source_fingerprint"], *(other["fingerprint"] for other in others(kept))]
    if len(digests) != len(pair.source_fingerprints):
        return None
    for digest, source in zip(digests, pair.source_fingerprints, strict=True):
        if digest != source.digest:
            if kept["source"] != pair.source_name:
                return None
            raise zo.MeshError(f"The source '{source.name}' was edited since it was matched: match again.")
    if kept["target_fingerprint"] != pair.target_fingerprint.digest:
        raise zo.MeshError(f"The target '{pair.target_name}' was edited since it was matched: match again.")
    triangle, barycentric, confidence = (read_layer(mesh, name).attribute.values for name in MATCH_ATTRIBUTES)
    # Stored in single precision: brought back to a sum of one.
    barycentric = barycentric.astype(np.float64) / barycentric.sum(axis=1, dtype=np.float64, keepdims=True)
    return StoredMatch(
        zo.SurfaceMap(triangle.astype(np.int64), barycentric, pair.source.triangles),
        confidence.astype(np.float64),
        tuple(kept["notes"]),
        kept.get("settings", {}),
        pair.source_names[1:],
    )


def description(mesh: Mesh) -> dict[str, Any] | None:
    """What is known about the match on a mesh, or None without one or if a part of it was removed."""
    if PROPERTY not in mesh or any(name not in mesh.attributes for name in MATCH_ATTRIBUTES):
        return None
    return json.loads(mesh[PROPERTY])


def others(kept: Mapping[str, Any]) -> list[dict[str, Any]]:
    """What `_described` tells of the objects that a target lies on besides its source."""
    return kept.get("others", [])


def low_confidence(confidence: np.ndarray) -> int:
    """How many vertices are of low confidence."""
    return int((confidence < LOW_CONFIDENCE).sum())


def _described(source: Fingerprint) -> dict[str, Any]:
    """A source besides the first one, as it is stored."""
    return {
        "name": source.name,
        "fingerprint": source.digest,
        "content": source.content,
        "mirrored": source.mirrored,
        "size": source.size,
    }
