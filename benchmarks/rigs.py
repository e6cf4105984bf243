# SPDX-License-Identifier: GPL-3.0-or-later
"""Rigs that are moved to bodies of other builds with known joints: the set `clothes`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree
from tqdm import tqdm

import zoomout_core as zo
from benchmarks.outfits.clothes import MADE_FOR, Body, Wardrobe
from benchmarks.tables import NOT_SHOWN, Record, Tables, over
from zoomout_core.arrays import Floats
from zoomout_core.geometry.procrustes import procrustes
from zoomout_core.library.asset_match import misfit_of
from zoomout_core.mesh.affine_maps import blend_matrices, transform_points
from zoomout_core.transfer.attribute import Attribute, Domain, Kind
from zoomout_core.transfer.rigging.rig import Deformation, joints_of_bones, place_joints

# Builds on which the numbers of `RigTuning` were set; the others judge them.
TUNED_ON = ("woman", "man", "child", "muscular_man", "slim_woman")
TUNED, JUDGED, AS_FOUND = "tuned on", "judged on", "as found"
# Joints of hands and of the face, by the beginnings of their names.
FINGERS = ("finger", "metacarpal")
FACE = ("eye", "jaw", "levator", "oculi", "orbic", "oris", "risor", "special", "temporal", "tongue")
# Methods: the product, the same along the true map, and simpler ones.
PRODUCT, BY_TRUE_MAP, AROUND, BOX = "move_rig", "move_rig, true map", "surface around", "bounding box"
# Images that the simple similarity of the surface around a joint follows, and the width of their weights relative to
# the distance of the farthest: as in the first experiments.
IMAGES, WIDTH = 60, 0.5
# Figures whose mean over the pairs a row has.
MEANS = "posed", "posed, true joints", "posed, true weights", "ratio", "feet", "s"
# Figures of each bone in the records.
ARRAYS = "errors", "alone", "bones"
# Number of bones in the table of those that are farthest off.
WORST_BONES = 20


@dataclass(frozen=True, eq=False)
class _Case:
    """Two bodies of the set.

    Attributes:
        kind: whether the target's build set numbers or judges them.
        name: the builds, and the topology of the target.
        source: the body with the rig.
        target: the body that receives it.
        same: the target in the source's topology.
        wardrobe: the set.
    """

    kind: str
    name: str
    source: Body
    target: Body
    same: Body
    wardrobe: Wardrobe


def run(data: Path, pairs: int | None) -> Tables:
    """Match bodies, and move the rig of one to the other.

    `rows`: for each kind of builds and each method medians and 95th percentiles of the distances of joints (heads of
    bones) from the truth, over all pairs, in percent of the target's height. `posed`: the mean distance of surface
    vertices from the truth over all poses, with the weights of the match, the same with the true joints, and with the
    true weights; `ratio` is of the first two. `feet`: how far the lowest vertex is from its true height. Kinds `as
    found` count for each target only the source with the smaller misfit, which a search in a library ranks first.
    `bones`: those that are farthest off on average, and how far they are along the true map: that much is due to the
    author, who did not place them by the surface; `posed` is the error of the posed surface if only the head of that
    bone is off. `each`: the figures of the product for each pair.

    Args:
        data: a folder with the set `clothes`.
        pairs: largest number of pairs of each kind; all when not given.
    """
    records: list[Record] = []
    for case in tqdm(list(_cases(data / "clothes", pairs)), leave=False):
        begin = process_time()
        match = zo.match(case.source.surface, case.target.surface)
        matched = process_time() - begin
        weights = _transferred_weights(case, match)
        of_truth = _pose(case, weights, case.target.bones.heads)
        for method, joints, seconds in _methods(case, match):
            about = {"kind": case.kind, "pair": case.name, "method": method, "match s": matched, "s": seconds}
            about |= {"target": case.name.partition(", ")[2], "misfit": misfit_of(match)}
            about |= {"bones": case.source.bones.names}
            records.append(about | _figures(case, joints, weights, of_truth))
            if method in (PRODUCT, BY_TRUE_MAP):
                records[-1]["alone"] = _each_alone(case, joints)
    product = [record for record in records if record["method"] == PRODUCT]
    shown = [{name: value for name, value in record.items() if name not in ARRAYS} for record in product]
    return {
        "rows": _rows(records + _as_found(records)),
        "bones": _bones(records),
        "each": shown,
        NOT_SHOWN: [_without_arrays(record) for record in records],
    }


def _cases(folder: Path, pairs: int | None) -> Iterator[_Case]:
    """The women's and the men's rig in all other builds, in every topology where these judge."""
    if not folder.is_dir():
        return
    wardrobe = Wardrobe(folder)
    chosen = {
        kind: [
            (source, build, topology)
            for build in wardrobe.builds
            if (build in TUNED_ON) == (kind == TUNED)
            for topology in (None, *(wardrobe.topologies if kind == JUDGED else ()))
            for source in MADE_FOR
            if source != build
        ]
        for kind in (TUNED, JUDGED)
    }
    for kind, cases in chosen.items():
        step = len(cases) if pairs is None else min(pairs, len(cases))
        for number in np.linspace(0, len(cases) - 1, step).round().astype(int).tolist():
            source, build, topology = cases[number]
            name = f"{source}, {build}, {topology or 'base'}"
            bodies = wardrobe.body(source), wardrobe.body(build, topology), wardrobe.body(build)
            yield _Case(kind, name, *bodies, wardrobe)


def _methods(case: _Case, match: zo.MatchResult) -> Iterator[tuple[str, Floats, float]]:
    """The heads of the bones in the target by each method, and its seconds of processor time without the match."""
    source, bones = case.source.surface, case.source.bones
    unit = float(np.sqrt(source.area))
    joints, parents = joints_of_bones(bones.heads, bones.tails, bones.parents)
    begin = process_time()
    moved = zo.move_rig(match, source, case.target.surface, joints, parents).positions
    yield PRODUCT, moved[: len(bones.names)], process_time() - begin
    begin = process_time()
    same = case.same.surface
    deformation = Deformation(source.vertices, same.vertices, source.vertex_areas, unit, same)
    moved = place_joints(deformation, joints, parents).positions
    yield BY_TRUE_MAP, moved[: len(bones.names)], process_time() - begin
    begin = process_time()
    yield AROUND, _around(case, match, bones.heads), process_time() - begin
    yield BOX, _in_box(bones.heads, source.vertices, case.target.surface.vertices), 0.0


def _around(case: _Case, match: zo.MatchResult, joints: Floats) -> Floats:
    """(j, 3) joints moved by the similarity of the nearest images of target vertices."""
    images = match.surface_map.interpolate(case.source.surface.vertices)
    distance, near = (np.asarray(each) for each in cKDTree(images).query(joints, IMAGES))
    trust = case.target.surface.vertex_areas * match.confidence
    weights = np.exp(-((distance / (WIDTH * distance[:, -1:])) ** 2) / 2) * trust[near]
    return procrustes(images[near], case.target.surface.vertices[near], weights)(joints[:, None])[:, 0]


def _in_box(joints: Floats, vertices: Floats, target: Floats) -> Floats:
    """(j, 3) joints scaled with the bounding box."""
    scale = np.ptp(target, axis=0) / np.ptp(vertices, axis=0)
    return (joints - vertices.min(axis=0)) * scale + target.min(axis=0)


def _transferred_weights(case: _Case, match: zo.MatchResult) -> csr_array:
    """(n_t, b) weights of the target by the match."""
    names = case.source.bones.names
    weights = Attribute("weights", Domain.POINT, Kind.WEIGHT, csr_array(case.source.weights), names)
    return csr_array(zo.transfer(weights, match, case.source.surface, case.target.surface).values)


def _pose(case: _Case, weights: csr_array, heads: Floats) -> list[Floats]:
    """(n_t, 3) the target in each pose, with weights (n_t, b) of bones with heads (b, 3)."""
    vertices = case.target.surface.vertices
    poses = (case.wardrobe.pose(number, heads) for number in range(len(case.target.poses)))
    return [transform_points(blend_matrices(pose, weights), vertices) for pose in poses]


def _figures(case: _Case, joints: Floats, weights: csr_array, of_truth: list[Floats]) -> Record:
    """The figures of some joints (b, 3), in percent of the target's height."""
    percent = 100 / float(np.ptp(case.target.surface.vertices[:, 1]))
    errors = percent * np.linalg.norm(joints - case.target.bones.heads, axis=1)
    areas = case.target.surface.vertex_areas
    truth = _pose(case, csr_array(case.target.weights), case.target.bones.heads)
    found = _pose(case, weights, joints)
    with_weights = _pose(case, csr_array(case.target.weights), joints)
    off, best, of_joints = (percent * _posed_error(each, truth, areas) for each in (found, of_truth, with_weights))
    feet = percent * max(abs(each[:, 1].min() - true[:, 1].min()) for each, true in zip(found, truth, strict=True))
    hand, face = (np.array([name.startswith(part) for name in case.source.bones.names]) for part in (FINGERS, FACE))
    groups = {"": errors, "body ": errors[~hand & ~face], "fingers ": errors[hand], "face ": errors[face]}
    figures = {name: value for group, each in groups.items() for name, value in _spread(group, each).items()}
    figures |= {"posed": off, "posed, true joints": best, "posed, true weights": of_joints}
    ratio = off / best if best else np.inf  # generated bodies may receive their weights exactly
    return figures | {"ratio": ratio, "feet": feet, "errors": groups}


def _each_alone(case: _Case, joints: Floats) -> Floats:
    """(b,) error of the posed surface in percent of the height if only one joint is where (b, 3) it was found."""
    bones, areas, weights = case.target.bones, case.target.surface.vertex_areas, csr_array(case.target.weights)
    truth = _pose(case, weights, bones.heads)
    found = np.zeros(len(joints))
    for bone, place in enumerate(joints):
        heads = bones.heads.copy()
        heads[bone] = place
        found[bone] = _posed_error(_pose(case, weights, heads), truth, areas)
    return 100 * found / float(np.ptp(case.target.surface.vertices[:, 1]))


def _posed_error(poses: list[Floats], truth: list[Floats], areas: Floats) -> float:
    """Mean distance of the surface in poses from where it should be."""
    return float(np.mean([_mean_distance(each, true, areas) for each, true in zip(poses, truth, strict=True)]))


def _mean_distance(found: Floats, truth: Floats, areas: Floats) -> float:
    """Mean distance of places (n, 3), weighted by areas (n,)."""
    return float(np.average(np.linalg.norm(found - truth, axis=1), weights=areas))


def _spread(name: str, errors: Floats) -> dict[str, float]:
    """The median and the 95th percentile; nothing without errors."""
    if not len(errors):
        return {}
    return {f"{name}median": float(np.median(errors)), f"{name}95 %": float(np.percentile(errors, 95))}


def _as_found(records: list[Record]) -> list[Record]:
    """The records of the sources that fit best: a man's rig for a man, mostly."""
    best: dict[str, float] = {}
    for record in records:
        best[record["target"]] = min(record["misfit"], best.get(record["target"], np.inf))
    chosen = (record for record in records if record["misfit"] == best[record["target"]])
    return [record | {"kind": f"{record['kind']}, {AS_FOUND}"} for record in chosen]


def _rows(records: list[Record]) -> list[Record]:
    rows = []
    for kind, method in dict.fromkeys((record["kind"], record["method"]) for record in records):
        chosen = [record for record in records if (record["kind"], record["method"]) == (kind, method)]
        row: Record = {"kind": kind, "method": method, "pairs": len(chosen)}
        for group in chosen[0]["errors"]:
            row |= _spread(group, np.concatenate([record["errors"][group] for record in chosen]))
        rows.append(row | {name: over(np.mean, chosen, name) for name in MEANS})
    return rows


def _bones(records: list[Record]) -> list[Record]:
    """A row for each of the bones that are farthest off, for each kind of builds."""
    rows = []
    for kind in dict.fromkeys(record["kind"] for record in records):
        of_kind = [record for record in records if record["kind"] == kind]
        errors = {
            method: np.array([record["errors"][""] for record in of_kind if record["method"] == method])
            for method in (PRODUCT, BY_TRUE_MAP)
        }
        mean, of_author = (each.mean(axis=0) for each in errors.values())
        alone = np.mean([record["alone"] for record in of_kind if record["method"] == PRODUCT], axis=0)
        for bone in np.argsort(-mean)[:WORST_BONES].tolist():
            row: Record = {"kind": kind, "bone": of_kind[0]["bones"][bone], PRODUCT: mean[bone]}
            row |= {"worst": errors[PRODUCT][:, bone].max(), BY_TRUE_MAP: of_author[bone], "posed": alone[bone]}
            rows.append(row)
    return rows


def _without_arrays(record: Record) -> Record:
    arrays = {"errors": record["errors"][""].tolist(), "bones": list(record["bones"])}
    return record | arrays | ({"alone": record["alone"].tolist()} if "alone" in record else {})
