# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo: build a character, pose and remesh it, match, transfer, and measure against the known truth."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import bpy
import numpy as np
import scipy

import zoomout_core as zo
from zoomout_core.arrays import Floats
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.runtime.outputs import atomic_write, make_folder

from .. import jobs, mesh_data, registered
from ..scene.pair import read_pair
from ..storage import stored_match
from ..storage.stored_report import transfer_report
from . import picture
from .baseline import KINDS, transfer_best
from .character import build_character, select_only
from .target import clear_pose, posed_copy, remeshed, set_pose
from .truth import Truth, correspondence_error, find_truth, torn_faces, unweighted_vertices

UNITS = {
    "uv": "widths of the atlas",
    "weights": "sum of absolute differences, at most 2",
    "color": "distance in linear RGB",
    "correspondence": "distance at rest over the square root of the area",
}


class Size(NamedTuple):
    """The size of the demo.

    Attributes:
        cell: approximate edge length of the character, in metres.
        voxel: size of the voxels that its posed copy is rebuilt from.
        target_vertices: approximate number of the target's vertices.
        width: width of the picture, in pixels.
        samples: light paths per pixel.
    """

    cell: float = 0.0134
    voxel: float = 0.0125
    target_vertices: int = 14000
    width: int = 1600
    samples: int = 24


FULL_SIZE = Size()


class DemoObjects(NamedTuple):
    """The objects of the demo, all at the same place, and the ground truth.

    Attributes:
        character: the source, at rest.
        armature: its armature.
        target: the posed and remeshed copy, which receives our transfer.
        baseline: another copy of that mesh, which receives Data Transfer's.
        source_surface: the character's surface.
        target_surface: the target's.
        truth: the values of a correct transfer.
    """

    character: bpy.types.Object
    armature: bpy.types.Object
    target: bpy.types.Object
    baseline: bpy.types.Object
    source_surface: zo.Surface
    target_surface: zo.Surface
    truth: Truth


def run(output: Path, size: Size = FULL_SIZE) -> dict[str, Any]:
    """Run the demo in Blender's current session, which it empties first.

    Args:
        output: folder for demo.blend, demo.png and report.json.
        size: the size of the demo.

    Returns:
        The content of report.json; `summary` puts it into words.
    """
    output = output.resolve()
    make_folder(output)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    seconds: dict[str, float] = {}
    with registered(), _timed(seconds, "total"):
        with _timed(seconds, "build"):
            demo = make_demo_objects(size)
        with _timed(seconds, "match"):
            select_only(demo.target, demo.character)
            bpy.ops.zoomout.match()
        with _timed(seconds, "transfer"):
            bpy.ops.zoomout.transfer()
        with _timed(seconds, "data_transfer_mappings"):
            mappings = transfer_best(demo.character, demo.baseline, demo.truth)
        report = _report_on(demo) | {"data_transfer_mappings": mappings, "seconds": seconds}
        with _timed(seconds, "picture"):
            picture.arrange(demo.character, demo.armature, demo.target, demo.baseline, report)
            with atomic_write(output / "demo.blend") as part:
                bpy.ops.wm.save_as_mainfile(filepath=str(part), compress=True, copy=True)
            with atomic_write(output / "demo.png") as part:
                picture.render(part, size.width, size.samples)
    with atomic_write(output / "report.json") as part:
        part.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    return report


def _report_on(demo: DemoObjects) -> dict[str, Any]:
    """The objects after both transfers: their sizes, errors and faults."""
    return {
        "versions": _versions(),
        "vertices": {
            "source": len(demo.character.data.vertices),
            "target": len(demo.target.data.vertices),
            "target_of_uncertain_truth": int((~demo.truth.known).sum()),
        },
        "errors": errors(demo),
        "units": UNITS,
        "torn_faces": {
            "of": len(demo.target.data.polygons),
            "zoomout": torn_faces(demo.target, demo.target_surface, demo.truth),
            "data_transfer": torn_faces(demo.baseline, demo.target_surface, demo.truth),
        },
        "unweighted_vertices": {
            "zoomout": unweighted_vertices(demo.target),
            "data_transfer": unweighted_vertices(demo.baseline),
        },
        "transfer": transfer_report(demo.target),
    }


def summary(report: dict[str, Any]) -> list[str]:
    """The content of a report, as lines of text."""
    vertices, seconds, torn = report["vertices"], report["seconds"], report["torn_faces"]
    lines = [
        f"Matched {vertices['target']:,} vertices in a new pose with a character of {vertices['source']:,} "
        f"in {seconds['match']:.1f} s, and transferred its data in {seconds['transfer']:.1f} s.",
        f"{'mean error':16}{'ZoomOut':>10}{'Data Transfer':>16}{'times better':>15}",
    ]
    for name, error in report["errors"].items():
        ours, theirs = error["zoomout"]["mean"], error["data_transfer"]["mean"]
        lines.append(f"{name:16}{ours:10.4f}{theirs:16.4f}{error['times_better_on_average']:15.1f}   {UNITS[name]}")
    return [*lines, f"{'torn faces':16}{torn['zoomout']:10}{torn['data_transfer']:16}   of {torn['of']:,}"]


def make_demo_objects(size: Size) -> DemoObjects:
    """Build the character, two copies of the target, and the ground truth."""
    character, armature = build_character(size.cell)
    set_pose(armature)
    posed = posed_copy(character)
    target = remeshed(posed, size.voxel, size.target_vertices)
    posed_positions = mesh_data.read_positions(posed.data).astype(float)
    bpy.data.meshes.remove(posed.data)
    clear_pose(armature)

    baseline = target.copy()
    baseline.data = target.data.copy()
    target.name, baseline.name = "ZoomOut", "Data Transfer"
    bpy.context.scene.collection.objects.link(baseline)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    source_surface = mesh_data.read_source_surface(character, depsgraph)
    target_surface = mesh_data.read_target_surface(target, depsgraph)
    truth = find_truth(character, source_surface, posed_positions, target_surface)
    return DemoObjects(character, armature, target, baseline, source_surface, target_surface, truth)


def errors(demo: DemoObjects) -> dict[str, Any]:
    """Statistics of the errors of both transfers and their maps, and the ratios between them."""
    found = {
        name: (kind.error(demo.target, demo.truth), kind.error(demo.baseline, demo.truth))
        for name, kind in KINDS.items()
    }
    pair = jobs.run(read_pair(bpy.context, demo.character.name, demo.target.name))
    match = stored_match.read(demo.target.data, pair)
    assert match is not None, "the match was just written"
    source, target = demo.source_surface, demo.target_surface
    in_space = zo.SurfaceMap(*closest_points(target.vertices, source.vertices, source.triangles), source.triangles)
    found["correspondence"] = (
        correspondence_error(match.surface_map, demo.truth, source),
        correspondence_error(in_space, demo.truth, source),
    )
    return {name: _compared(ours, theirs) for name, (ours, theirs) in found.items()}


def _compared(ours: Floats, theirs: Floats) -> dict[str, Any]:
    both = {"zoomout": _statistics(ours), "data_transfer": _statistics(theirs)}
    # A median may be zero where colours are flat; the mean never is.
    return {**both, "times_better_on_average": both["data_transfer"]["mean"] / both["zoomout"]["mean"]}


def _statistics(values: Floats) -> dict[str, float]:
    return {
        "mean": float(values.mean()),
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95)),
    }


def _versions() -> dict[str, str]:
    return {
        "blender": bpy.app.version_string,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }


@contextmanager
def _timed(seconds: dict[str, float], name: str) -> Iterator[None]:
    start = perf_counter()
    yield
    seconds[name] = round(perf_counter() - start, 2)
