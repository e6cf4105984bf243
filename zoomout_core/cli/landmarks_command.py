# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout landmarks`: a template's landmarks on other meshes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import click
import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.assets.files import MESHES, inputs_of
from zoomout_core.assets.part_names import parts_of_file
from zoomout_core.batch import (
    Job,
    check_inputs_stay,
    plan,
    report_outcomes,
    run_batch,
)
from zoomout_core.cli.report import json_option, match_figures
from zoomout_core.command_options import batch_options, files_of_options, match_options, refusals, start_arguments
from zoomout_core.geometry.closest_points import closest_points
from zoomout_core.landmark_files import (
    FORMATS,
    LandmarkSet,
    landmark_ending,
    read_landmark_file,
    write_landmark_file,
)
from zoomout_core.map_files import keep_map, save_match
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.pair import on_surface
from zoomout_core.matching.pipeline import match
from zoomout_core.matching.ranking.mirror_image import mirror_candidate
from zoomout_core.matching.report.verdict import (
    AMBER,
    GREEN,
    LOW_CONFIDENCE,
    VERDICT,
    Verdict,
    check_verdict,
    select_notes,
)
from zoomout_core.matching.result import MatchResult
from zoomout_core.matching.transfer_landmarks import transfer_landmarks
from zoomout_core.mesh.formats.files import read_shape
from zoomout_core.mesh.input_checks import measurable, vertex_numbers
from zoomout_core.mesh.named_parts import NamedParts
from zoomout_core.mesh.shapes import as_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import message, note_figures, note_lines, sentences, warning
from zoomout_core.runtime.outputs import make_folder
from zoomout_core.runtime.progress import portion

# Fraction of the progress at the end of matching.
MATCHED = 0.7
# LPS and RAS coordinates differ in the signs of x and y.
SIGNS = np.array([-1.0, -1.0, 1.0])
ALL_SURE = "All {count} landmarks are placed with confidence."
SOME_UNCERTAIN = "{uncertain} of {count} landmarks are uncertain: {names}."
CHECK = "Look at these, and move them if needed."
MIRRORED = (
    "The target seems to be a mirror image of the template, as a left bone is of a right one, so a mirrored map placed "
    "its landmarks."
)


@dataclass(frozen=True, eq=False)
class Template:
    """A mesh with landmarks.

    Attributes:
        surface: the mesh.
        landmarks: as their file has them.
        points: (q, 3) positions in the mesh's frame.
        signs: (3,) factors from the file's coordinates to the mesh's.
        parts: the parts of the surface.
        notes: sentences for the user.
    """

    surface: Surface
    landmarks: LandmarkSet
    points: Floats
    signs: Floats
    parts: NamedParts
    notes: tuple[str, ...]


@click.command()
@batch_options(
    [*FORMATS],
    None,
    "Format of the files in a folder; that of LANDMARKS by default.",
    {"template": "TEMPLATE", "positions": "LANDMARKS"},
)
@json_option
@match_options
def landmarks(
    template: str,
    positions: str,
    targets: tuple[str, ...],
    output: str,
    ending: str | None,
    in_place: bool,
    candidate: int,
    force: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Place the landmarks of TEMPLATE on other meshes.

    TEMPLATE and TARGETS are meshes, such as scans of bones and teeth. LANDMARKS is a .csv file with a line
    `name,x,y,z`, `x,y,z`, `name,vertex` or `vertex` for each landmark, or a .mrk.json or .fcsv file of 3D Slicer. The
    landmarks of each target are written with a confidence from 0 to 1: a column in CSV, the description in Slicer.
    Check landmarks with a confidence below 0.5. A target that is a mirror image of TEMPLATE, such as a left bone beside
    a right one, is matched as such, with a note.

    A folder among TARGETS stands for the meshes in it. In an output folder each file is named after its target, and
    report.json lists the result of each; a target that fails does not affect the others.

    The exit code is 0 if all were written, 1 if none was, and 3 if some were.
    """
    with refusals():
        extension = landmark_ending(positions) if ending is None else f".{ending}"
        jobs = plan(template, targets, output, extension, MESHES, landmark_ending, in_place)
        if not in_place:
            files = [template, positions, *(str(job.target) for job in jobs), *files_of_options(options)]
            check_inputs_stay(jobs, output, inputs_of(*files))
        arguments, known = start_arguments(**options), read_template(template, positions)
        given = {"landmarks": positions, "candidate": candidate, "force": force, **options}
        outcomes, figures = run_batch(
            template, jobs, partial(_run_job, known, candidate, force, arguments), given, output
        )
    report_outcomes(outcomes, figures, output, as_json)


def read_template(mesh: str, positions: str) -> Template:
    """Read a mesh and the landmarks on it.

    A mesh file does not say whether it is in LPS or RAS coordinates. If landmarks are off the surface in their own
    coordinates, but on it in the other ones, they are converted.

    Raises:
        MeshError: a file cannot be read, or a landmark is not near the surface.
    """
    surface, found = as_surface(read_shape(mesh)), read_landmark_file(positions)
    parts = parts_of_file(mesh, surface)
    if found.vertices is not None:
        number = vertex_numbers(found.vertices, len(surface.vertices), f"Landmarks in {positions}")
        return Template(surface, found, surface.vertices[number], np.ones(3), parts, ())
    points, signs = found.points, np.ones(3)
    notes: tuple[str, ...] = ()
    if found.system and _distance(surface, points) > _distance(surface, SIGNS * points):
        points, signs = SIGNS * points, SIGNS
        notes = (message("The landmarks are in {system} coordinates, the mesh is not.", system=found.system),)
    on_surface("source", surface, points)
    return Template(surface, found, points, signs, parts, notes)


def _distance(surface: Surface, points: Floats) -> float:
    """Mean distance of points from a surface."""
    if not measurable(points).all():
        return np.inf
    triangle, weights = closest_points(points, surface.vertices, surface.triangles)
    feet = np.einsum("qc,qcx->qx", weights, surface.vertices[surface.triangles[triangle]])
    return float(np.linalg.norm(feet - points, axis=1).mean())


def _run_job(
    template: Template, candidate: int, force: bool, arguments: dict[str, Any], job: Job, report: dict[str, Any]
) -> list[str]:
    """Place the landmarks on one target, and write them; returns the lines of its outcome, and fills in its report."""
    target = as_surface(read_shape(job.target))
    with portion(0.0, MATCHED):
        result = match(template.surface, target, **arguments)
    notes = [*template.notes]
    if not candidate and (mirrored := mirror_candidate(result)) is not None:
        candidate = mirrored
        notes.append(warning(MIRRORED))
    if candidate:
        with portion(MATCHED, MATCHED):
            result = result.use(candidate)
    notes += result.notes
    report |= {**match_figures(result, template.parts), **note_figures(notes)}
    check_verdict(result.verdict, force, len(result.candidates))
    with keep_map(partial(save_match, result), job.output):
        with portion(MATCHED, 1.0):
            points, confidence = transfer_landmarks(result, template.points)
        # The nearest corner of the triangle that a point is on: the nearest vertex may be beyond a thin wall.
        on_target = SurfaceMap(*closest_points(points, target.vertices, target.triangles), target.triangles)
        placed = template.landmarks.move(template.signs * points, confidence, on_target.vertex)
        make_folder(job.output.parent)
        write_landmark_file(placed, job.output)
    names = [name or str(number) for number, name in enumerate(placed.names, start=1)]
    uncertain = [name for name, low in zip(names, confidence < LOW_CONFIDENCE, strict=True) if low]
    verdict = _verdict(result, uncertain, len(names))
    report |= {
        "landmarks": [
            {"name": name, "position": point, "confidence": value}
            for name, point, value in zip(names, placed.points.tolist(), confidence.tolist(), strict=True)
        ],
        "uncertain": uncertain,
        "landmark_verdict": verdict._asdict(),
    }
    return [verdict.line, *note_lines(select_notes(notes, verdict))]


def _verdict(result: MatchResult, uncertain: list[str], count: int) -> Verdict:
    """Whether to use the landmarks: they may be right where the match has faults, but not if it is wrong as a whole."""
    of_match = result.verdict
    if of_match.is_wrong:
        return of_match
    text = message(SOME_UNCERTAIN, uncertain=len(uncertain), count=count, names=", ".join(uncertain))
    if result.certainty < VERDICT.certain:
        return Verdict(AMBER, sentences(of_match.sentence, *[text] * bool(uncertain)), of_match.advice)
    if uncertain:
        return Verdict(AMBER, text, message(CHECK))
    return Verdict(GREEN, message(ALL_SURE, count=count), "")
