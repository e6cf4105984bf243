# SPDX-License-Identifier: GPL-3.0-or-later
"""A match, stored on the target's mesh as three or four attributes and a custom property that describes it.

Triangles are numbered like Blender's `loop_triangles` of the source: of its own mesh if the modifiers keep its faces,
else of the evaluated mesh. Barycentric coordinates follow the triangles' corners, which are in opposite order on a
mirrored object, see `mesh_data`. If a target maps to several objects, their triangles are numbered one object after
another. If modifiers change the faces, and a later pose folds one so that Blender triangulates it differently, points
move within that face.
"""

from __future__ import annotations

import json
import zlib
from base64 import b64decode, b64encode
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from bpy.types import Mesh

import zoomout_core as zo
from zoomout_core.arrays import Booleans, Floats
from zoomout_core.maps.surface_map import fault_of_map
from zoomout_core.matching.report.verdict import LEVELS, LOW_CONFIDENCE
from zoomout_core.messages import to_json
from zoomout_core.transfer import Attribute, Domain, Kind

from ..mesh_data import HAS_PARTNER, MATCH_ATTRIBUTES, Fingerprint, Layer, ObjectPair, Role, read_layer, write_layer
from ..mesh_data.arrays import hash_of
from .stored_json import Kind as JsonKind
from .stored_json import read_json

TRIANGLE, BARYCENTRIC, CONFIDENCE = MATCH_ATTRIBUTES
PROPERTY = "zoomout_match"
# The types of these attributes, and the entries of a description; those of earlier versions lack what may be None.
TYPES = "INT", "FLOAT_VECTOR", "FLOAT"
STATE: dict[str, JsonKind] = {"content": str, "size": [int, int], "mirrored": bool}
ENTRIES: dict[str, JsonKind] = {
    "source": str,
    "source_fingerprint": str,
    "target_fingerprint": str,
    **{name: {"source": kind, "target": kind} for name, kind in STATE.items()},
    "others": (None, [{"name": str, "fingerprint": str, **STATE}]),
    "vertices": int,
    "low_confidence": int,
    "without_partner": (None, [(int, float), (int, float)]),
    "source_has_partner": (None, str),
    "torn": (None, str),
    "notes": [str],
    "settings": (None, dict),
}
# Key in the stored settings for the fingerprint of the landmarks that were used.
LANDMARKS = "landmarks_fingerprint"


@dataclass(frozen=True, eq=False)
class StoredMatch:
    """The part of a match that a transfer needs.

    Attributes:
        surface_map: a point on the source, or on several joined ones, for each vertex of the target.
        confidence: (n_t,) confidence of each vertex, in [0, 1].
        notes: sentences for the user.
        settings: arguments of `match_objects` for it, as far as known.
        others: names of further sources that the target maps to.
        has_partner: (n_t,) whether each vertex has a partner on the source; None if that is not known.
        source_has_partner: (n_s,) the same for the source's vertices.
        without_partner: the fractions of the target's and of the source's area without a partner, in [0, 1].
        verdict: whether to use the match; None if that is not known.
        torn: (n_t,) vertices at which the match is torn; None if that is not known.
    """

    surface_map: zo.SurfaceMap
    confidence: np.ndarray
    notes: tuple[str, ...]
    settings: dict[str, Any] = field(default_factory=dict)
    others: tuple[str, ...] = ()
    has_partner: Booleans | None = None
    source_has_partner: Booleans | None = None
    without_partner: tuple[float, float] | None = None
    verdict: zo.Verdict | None = None
    torn: Booleans | None = None


Match: TypeAlias = "zo.MatchResult | zo.ProximityMatch | StoredMatch"


def along(match: Match, surface_map: zo.SurfaceMap, confidence: Floats) -> StoredMatch:
    """A match with another map and confidence (n_t,) in place of its own."""
    of_source, torn, verdict = _judgements(match)
    return StoredMatch(
        surface_map,
        confidence,
        match.notes,
        has_partner=match.has_partner,
        source_has_partner=of_source,
        without_partner=without_partner(match),
        verdict=verdict,
        torn=torn,
    )


def _judgements(match: Match) -> tuple[Booleans | None, Booleans | None, zo.Verdict | None]:
    """(n_s,) which vertices of the source have a partner, (n_t,) which are torn, and the verdict; None if not known."""
    if isinstance(match, zo.ProximityMatch):
        return None, None, None
    return match.source_has_partner, match.torn, match.verdict


def write(mesh: Mesh, match: Match, pair: ObjectPair, settings: Mapping[str, Any]) -> None:
    """Store a match on the target's mesh; it replaces an earlier one.

    Args:
        mesh: the target's mesh.
        match: the match.
        pair: its two objects.
        settings: arguments that it was computed with; only numbers and strings are stored.
    """
    _write_layers(mesh, match)
    mesh[PROPERTY] = json.dumps(_describe_match(mesh, match, pair, settings))
    mesh.update()


def _write_layers(mesh: Mesh, match: Match) -> None:
    """Write the attributes of a match; `HAS_PARTNER` is removed if the match does not know it."""
    for name, kind, data_type, values in (
        (TRIANGLE, Kind.LABEL, "INT", match.surface_map.triangle),
        (BARYCENTRIC, Kind.VECTOR, "FLOAT_VECTOR", match.surface_map.barycentric),
        (CONFIDENCE, Kind.SCALAR, "FLOAT", match.confidence),
    ):
        write_layer(mesh, Layer(Attribute(name, Domain.POINT, kind, values), Role.GENERIC, data_type))
    if HAS_PARTNER in mesh.attributes:
        mesh.attributes.remove(mesh.attributes[HAS_PARTNER])
    if match.has_partner is not None:
        mask = Attribute(HAS_PARTNER, Domain.POINT, Kind.BOOLEAN, match.has_partner)
        write_layer(mesh, Layer(mask, Role.GENERIC, "BOOLEAN"))


def _describe_match(mesh: Mesh, match: Match, pair: ObjectPair, settings: Mapping[str, Any]) -> dict[str, Any]:
    """The description of a match whose attributes are on a mesh, with the `ENTRIES`."""
    (source, *further), target = pair.source_fingerprints, pair.target_fingerprint
    of_source, torn, verdict = _judgements(match)
    return {
        "source": source.name,
        "source_fingerprint": source.digest,
        "target_fingerprint": target.digest,
        # For fast checks, see `preflight.stale`.
        "content": {"source": source.content, "target": target.content},
        "size": {"source": source.size, "target": target.size},
        "mirrored": {"source": source.mirrored, "target": target.mirrored},
        "others": [_describe_source(other) for other in further],
        "entries": _hash_of_entries(mesh),
        "vertices": len(match.confidence),
        "low_confidence": low_confidence(match.confidence),
        "without_partner": without_partner(match),
        "source_has_partner": None if of_source is None else pack_mask(of_source),
        "verdict": None if verdict is None else to_json(list(verdict)),
        "torn": None if torn is None else pack_mask(torn),
        "notes": to_json(match.notes),
        "settings": {name: value for name, value in settings.items() if isinstance(value, (int, float, str))},
    }


def read(mesh: Mesh, pair: ObjectPair) -> StoredMatch | None:
    """The match of this pair stored on the target's mesh, or None if there is none, or it has another source.

    Raises:
        MeshError: the source or the target was edited since, or the match is damaged.
    """
    stored = description(mesh)
    if stored is None:
        return None
    if not _is_of_sources(stored, pair):
        return None
    if stored["target_fingerprint"] != pair.target_fingerprint.digest:
        raise zo.MeshError(
            "The target '{target}' was edited since it was matched: match again.", target=pair.target_name
        )
    triangle, barycentric, confidence = (read_layer(mesh, name).attribute.values for name in MATCH_ATTRIBUTES)
    exchanged = stored.get("entries") not in (None, _hash_of_entries(mesh))  # missing in files of earlier versions
    fault = fault_of_map(triangle, barycentric, len(pair.source.triangles))
    if exchanged or fault or not np.isfinite(confidence).all():
        raise zo.MeshError("The match stored on '{target}' is damaged: match again.", target=pair.target_name)
    # They are stored in single precision: rescale them to a sum of one.
    barycentric = barycentric.astype(np.float64) / barycentric.sum(axis=1, dtype=np.float64, keepdims=True)
    return StoredMatch(
        surface_map=zo.SurfaceMap(triangle.astype(np.int64), barycentric, pair.source.triangles),
        confidence=confidence.astype(np.float64),
        notes=tuple(stored["notes"]),
        settings=stored.get("settings") or {},
        others=pair.source_names[1:],
        has_partner=read_layer(mesh, HAS_PARTNER).attribute.values if HAS_PARTNER in mesh.attributes else None,
        source_has_partner=unpack_mask(stored.get("source_has_partner"), len(pair.source.vertices)),
        without_partner=stored.get("without_partner"),
        verdict=verdict_of(stored),
        torn=unpack_mask(stored.get("torn"), len(confidence)),
    )


def _is_of_sources(stored: Mapping[str, Any], pair: ObjectPair) -> bool:
    """Whether a match, by its description, has the sources of a pair.

    Raises:
        MeshError: it has, but one of them was edited since.
    """
    digests = [stored["source_fingerprint"], *(other["fingerprint"] for other in others(stored))]
    if len(digests) != len(pair.source_fingerprints):
        return False
    for digest, source in zip(digests, pair.source_fingerprints, strict=True):
        if digest != source.digest:
            if stored["source"] != pair.source_name:
                return False
            raise zo.MeshError(
                "The source '{source}' was edited since it was matched: match again.", source=source.name
            )
    return True


def verdict_of(stored: Mapping[str, Any]) -> zo.Verdict | None:
    """The verdict in the description of a match, or in a report; None if it has none, such as for nearest points."""
    verdict = stored.get("verdict")
    if isinstance(verdict, dict):  # as in reports
        verdict = [verdict.get(name) for name in zo.Verdict._fields]
    if not isinstance(verdict, list) or len(verdict) != len(zo.Verdict._fields) or verdict[0] not in LEVELS:
        return None
    return zo.Verdict(*map(str, verdict))


def pack_verdict(match: Match) -> dict[str, str] | None:
    """The verdict on a match for reports, see `verdict_of`; None if it is not known, such as for nearest points."""
    _, _, verdict = _judgements(match)
    return None if verdict is None else verdict._asdict()


def is_wrong(match: Match) -> bool:
    """Whether a match is probably wrong; False if that is not known, such as for nearest points."""
    _, _, verdict = _judgements(match)
    return verdict is not None and verdict.is_wrong


def _hash_of_entries(mesh: Mesh) -> str:
    """A hash of the attributes, to detect when those of another match have replaced them."""
    return hash_of("", *(read_layer(mesh, name).attribute.values for name in MATCH_ATTRIBUTES))


def description(mesh: Mesh) -> dict[str, Any] | None:
    """The description of the match on a mesh, or None if there is none, or a part is missing or damaged."""
    layers = (mesh.attributes.get(name) for name in MATCH_ATTRIBUTES)
    if [layer and (layer.domain, layer.data_type) for layer in layers] != [("POINT", kind) for kind in TYPES]:
        return None
    return read_json(mesh, PROPERTY, ENTRIES)


def remove(mesh: Mesh) -> None:
    """Remove the match, or its remains, from a mesh."""
    for name in (*MATCH_ATTRIBUTES, HAS_PARTNER):
        if name in mesh.attributes:
            mesh.attributes.remove(mesh.attributes[name])
    if PROPERTY in mesh:
        del mesh[PROPERTY]


def others(stored: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The further sources that a target maps to, as dictionaries from `_describe_source`."""
    return stored.get("others") or []


def low_confidence(confidence: np.ndarray) -> int:
    """The number of vertices of low confidence."""
    return int((confidence < LOW_CONFIDENCE).sum())


def without_partner(match: Match) -> tuple[float, float] | None:
    """The fractions of the target's and of the source's area without a partner, in [0, 1]; None if not known."""
    if isinstance(match, zo.MatchResult):
        return match.share_without_partner, match.source_share_without_partner
    return match.without_partner if isinstance(match, StoredMatch) else None


def pack_mask(mask: Booleans) -> str:
    """A mask (n,) as text, which is short if its elements are contiguous."""
    return b64encode(zlib.compress(np.packbits(mask).tobytes())).decode()


def unpack_mask(text: str | None, count: int) -> Booleans | None:
    """(count,) the mask from the text of `pack_mask`; None if the text is missing or damaged."""
    if text is None:
        return None
    try:
        content = zlib.decompressobj().decompress(b64decode(text), (count + 7) // 8)
    except (ValueError, TypeError, zlib.error):  # damaged
        return None
    found = np.unpackbits(np.frombuffer(content, np.uint8))[:count].astype(bool)
    return found if len(found) == count else None


def _describe_source(source: Fingerprint) -> dict[str, Any]:
    """The stored form of a source other than the first."""
    return {
        "name": source.name,
        "fingerprint": source.digest,
        "content": source.content,
        "mirrored": source.mirrored,
        "size": source.size,
    }
