"""Parameters that several filters have, what they mean to the core, and the correspondence that filters work with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import zoomout_core as zo
from meshlab_filter.mesh_data import Layer
from meshlab_filter.parameters import CHOICE, COUNT, DATA, MESH, SWITCH, TEXT, Parameter
from meshlab_filter.stored import Correspondence, read_stored
from zoomout_core.maps.surface_map import read_vertex_map
from zoomout_core.matching.options import PARTIAL
from zoomout_core.matching.presets import DETAIL, resolve_detail
from zoomout_core.runtime.progress import portion
from zoomout_core.text_arguments import STARTS, read_axis, read_landmarks

if TYPE_CHECKING:
    from pymeshlab import MeshSet

SOURCE = Parameter("sourcemesh", MESH, 0, "The mesh that gives.")
TARGET = Parameter("targetmesh", MESH, 1, "The mesh that receives.")
STORED = Parameter(
    "correspondence",
    TEXT,
    "correspondence",
    "The name under which compute_correspondence_by_zoomout stored it on the target.",
)
STORED_OR_NEW = Parameter(
    "correspondence",
    TEXT,
    "",
    "The name under which compute_correspondence_by_zoomout stored it on the target; empty: find one.",
)
ACCURACY = (
    Parameter("detail", CHOICE, "balanced", "How fine a stand-in for each mesh is matched.", tuple(DETAIL)),
    Parameter("seed", COUNT, 0, "Of the eigensolver."),
)
MATCHING = (
    Parameter("initial", CHOICE, "auto", "How a correspondence is begun.", (*STARTS, "given")),
    Parameter("landmarks", DATA, None, "Pairs of source and target vertices or points, or a text file, a pair a line."),
    Parameter("exact_landmarks", SWITCH, False, "Bend the correspondence so that it hits the landmarks."),
    Parameter("initial_map", DATA, None, "An earlier map, or the .npz file that `zoomout match` wrote it to."),
    Parameter("common_axes", DATA, None, "Directions (a, 3) in which both meshes stand alike, or x, y or z."),
    Parameter("partial", CHOICE, "auto", "Whether one mesh is tried as a part of the other.", PARTIAL),
    *ACCURACY,
    Parameter("candidate", COUNT, 0, "Which correspondence to use: another where sides are swapped."),
)


def match_layers(source: Layer, target: Layer, candidate: int, **matching: Any) -> zo.MatchResult:
    """The correspondence of two layers, by the parameters MATCHING."""
    with portion(0.0, 0.85):
        result = zo.match(source.shape, target.shape, **_arguments(**matching))
    if candidate:
        with portion(0.85, 1.0):
            result = result.use(candidate)
    return result


def find_correspondence(
    ms: MeshSet, source: Layer, target: Layer, targetmesh: int, correspondence: str, **matching: Any
) -> tuple[Correspondence | zo.MatchResult, dict[str, Any]]:
    """The correspondence of two layers, by the parameters STORED_OR_NEW and MATCHING, and what to say of it."""
    if correspondence:
        stored = read_stored(ms.mesh(targetmesh), correspondence, source)
        return stored, {"confidence": stored.confidence, "notes": []}
    found = match_layers(source, target, **matching)
    return found, report_on(found)


def report_on(result: zo.MatchResult) -> dict[str, Any]:
    """What a filter says of the correspondence that it found."""
    return {
        "confidence": result.confidence,
        "has_partner": result.has_partner,
        "source_has_partner": result.source_has_partner,
        "share_without_partner": result.share_without_partner,
        "source_share_without_partner": result.source_share_without_partner,
        "certainty": result.certainty,
        "candidates": [
            {"origin": found.origin, "reverses_orientation": found.reverses_orientation, **found.scores}
            for found in result.candidates
        ],
        "notes": list(result.notes),
    }


def _arguments(
    initial: str,
    landmarks: Any,
    exact_landmarks: bool,
    initial_map: Any,
    common_axes: Any,
    partial: str,
    detail: str,
    seed: int,
) -> dict[str, Any]:
    """What the parameters mean to `zoomout_core.match`."""
    return resolve_detail(
        detail,
        seed=seed,
        initial=initial,
        partial=partial,
        landmarks=read_landmarks(landmarks) if isinstance(landmarks, str) else landmarks,
        exact_landmarks=exact_landmarks,
        initial_map=read_vertex_map(initial_map) if isinstance(initial_map, str) else initial_map,
        common_axes=[read_axis(common_axes, "common_axes")] if isinstance(common_axes, str) else common_axes,
    )
