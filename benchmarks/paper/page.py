# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables and figures of ZoomOut's paper on one page, next to the published figures."""

from __future__ import annotations

import inspect
import json
import os
import platform
import traceback
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
import scipy
from tqdm import tqdm

from benchmarks.paper import (
    clutter,
    discretisation,
    downsampled,
    initial_size,
    large,
    overfitting,
    partial,
    point_clouds,
    readings,
    refinement,
    signs,
    step_size,
    symmetry,
)
from benchmarks.stored import storing
from benchmarks.tables import NOT_SHOWN, Record, Tables, as_markdown

# Code that computes maps, besides the core's and that of a section.
HERE = Path(__file__).parent
CODE = [HERE.parent / "baselines", HERE / "starts.py", HERE / "flips.py"]


@dataclass(frozen=True, eq=False)
class Section:
    """A section of the page.

    Attributes:
        name: the name of its command, and of the files of its figure and its records.
        title: its heading.
        published: the paper's figures.
        setup: the methods compared here, and differences from the paper; nothing that the figures decide.
        reading: sentences from the figures of the tables.
        run: computes the tables from the folder of the sets, the number of pairs, and the file for the figure, which it
            may not write.
    """

    name: str
    title: str
    published: str
    setup: str
    reading: Callable[[Tables], list[str]]
    run: Callable[[Path, int | None, Path], Tables]


SECTIONS = (
    Section(
        "refinement",
        "Refinement",
        "ZoomOut is more accurate than ICP, Deblur, RHM, PMF and BCICP from the same initial maps, 19 times "
        "as fast as BCICP, and 170 times with samples.",
        "The meshes are remeshed one by one. SHOT descriptors replace learned ones. `zo.match` has no initial map.",
        readings.refinement,
        refinement.run,
    ),
    Section(
        "shrec19",
        "SHREC'19",
        "On 430 pairs, from an initial mean of 60.4, ZoomOut with samples reaches 28.8, and BCICP 30.1; ZoomOut is 290 "
        "times as fast.",
        "The pairs are those among the shapes at hand, remeshed to 5,000 vertices; the paper's have 5,000 to 200,000. "
        "Initial maps are from wave kernel signatures and two random landmarks, not the paper's own. `zo.match` has no "
        "initial map.",
        readings.refinement,
        refinement.run_shrec19,
    ),
    Section(
        "step_size",
        "Step size",
        "Steps of 1 to 10 are equally accurate.",
        "Maps are refined on 1,500 samples.",
        readings.step_size,
        step_size.run,
    ),
    Section(
        "initial_size",
        "Size of the initial map",
        "Small initial maps are enough, and noise hardly matters.",
        "A pair ends right if its error is below 80.",
        readings.initial_size,
        initial_size.run,
    ),
    Section(
        "overfitting",
        "Size of a fitted map",
        "Maps fitted to descriptors get worse as they get larger; ZoomOut from the fitted map of size 20 gets better.",
        "",
        readings.overfitting,
        overfitting.run,
    ),
    Section(
        "signs",
        "Symmetries from signs",
        "Among all signs of the first four eigenfunctions, the three symmetries of a vase commute best with "
        "the Laplacian.",
        "",
        readings.signs,
        signs.run,
    ),
    Section(
        "symmetry",
        "Symmetries",
        "From an orientation-reversing initial map of 68.0, ZoomOut reaches 16.1 on FAUST, BCICP 29.2.",
        "Every person is remeshed with 5,000 vertices, not alike on both sides; the paper has FAUST's own "
        "meshes. `zo.detect_symmetry` has no initial map.",
        readings.symmetry,
        lambda d, n, f: symmetry.run(d, n, False, f),
    ),
    Section(
        "large",
        "Large meshes",
        "On FARM, with up to 50,000 vertices: initial 82.1, ICP 57.8 to 78.9, RHM 60.3, ZoomOut 28.3 in 77 s,"
        " and 29.3 in 1.2 s with samples.",
        "FARM's shapes are not at hand: these are TOSCA's, whose pairs are isometric. The seconds of "
        "`zo.match` include the bases.",
        readings.large,
        large.run,
    ),
    Section(
        "downsampled",
        "Refined on fewer vertices",
        "Maps that are refined on 500 to 5000 vertices and carried to all are nearly as accurate.",
        "",
        readings.downsampled,
        downsampled.run,
    ),
    Section(
        "point_clouds",
        "Point clouds",
        "Initial 51.0, ICP 49.7, ZoomOut with samples 22.3.",
        "Clouds of TOSCA have noise, and touching limbs, which the surface through the points joins. "
        "`zo.match` has none of the landmarks that the others begin with.",
        readings.point_clouds,
        point_clouds.run,
    ),
    Section(
        "discretisation",
        "Discretisations",
        "Maps hardly depend on how a shape is meshed.",
        "Each kind of mesh against each other kind, of other people, with nothing given.",
        readings.discretisation,
        discretisation.run,
    ),
    Section(
        "clutter",
        "An object in clutter",
        "In a Hamiltonian basis, ZoomOut covers more of the object in the scene than LMH's first step.",
        "LMH and ZoomOut are given the same sparse true matches. PFM and `zo.match` are given none.",
        readings.clutter,
        clutter.run,
    ),
    Section(
        "partial",
        "Parts of shapes",
        "On SHREC'16 cuts, ZoomOut takes 6 s and PFM 70 s; errors are shown as curves beside PFM, GTM, FC and CPD.",
        "PFM and ZoomOut begin with the same functional map of SHOT descriptors, whose seconds count for "
        "both. PFM's weights are ours, as its descriptors are scaled otherwise. `zo.match` has no initial "
        "map.",
        readings.partial,
        partial.run,
    ),
)


def run(
    data: Path | None, pairs: int | None, page: Path, only: tuple[str, ...] = (), pair_records: Path | None = None
) -> list[str]:
    """Compute the tables one after the other and write the page.

    Figures and records are written to a folder beside the page, named like it without the extension: `NAME.png`,
    `NAME.json`. An earlier section that is not requested now is taken from its records, which have the tables but not
    single pairs. A section that fails is named on the page, and the others are computed nevertheless.

    Most sections take hours. Their records of single pairs are appended to files in another folder, from which a run
    that was interrupted is resumed.

    Args:
        data: folder of the sets; None to write the page from the records alone.
        pairs: number of pairs of each set, evenly spread; by default each table's own choice.
        page: the Markdown file to write.
        only: names of the sections to compute; all if empty.
        pair_records: folder of the records of single pairs, `NAME.jsonl`; nothing is resumed without it.

    Returns:
        The failures, one sentence each.

    Raises:
        ValueError: a name that no section has.
    """
    folder = page.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    if data is not None:
        for section in tqdm(chosen_sections(only)):
            _records_file(folder, section).write_text(
                json.dumps(_make(section, data, pairs, folder, pair_records), indent=1)
            )
    made = {
        section: json.loads(_records_file(folder, section).read_text())
        for section in SECTIONS
        if _records_file(folder, section).is_file()
    }
    page.write_text(as_page(made, folder))
    return [f"{section.name}: {record['failed']}" for section, record in made.items() if record["failed"]]


def chosen_sections(only: Collection[str]) -> list[Section]:
    """The sections with these names; all if there are none.

    Raises:
        ValueError: a name that no section has.
    """
    known = [section.name for section in SECTIONS]
    for name in only:
        if name not in known:
            raise ValueError(f"The page has no section {name!r}: it has {', '.join(known)}.")
    return [section for section in SECTIONS if not only or section.name in only]


def _records_file(folder: Path, section: Section) -> Path:
    return folder / f"{section.name}.json"


def _make(section: Section, data: Path, pairs: int | None, folder: Path, pair_records: Path | None) -> Record:
    """The tables of a section, how they were computed, and the reason if that failed."""
    begin = perf_counter()
    tables: Tables = {}
    failed = None
    figure = folder / f"{section.name}.png"
    drawn = folder / f"{section.name}_new.png"
    reused: list[float] = []
    try:
        with _storing(section, pair_records, reused):
            made = section.run(data, pairs, drawn)
        tables = {name: rows for name, rows in made.items() if rows and name != NOT_SHOWN}
    except Exception as error:  # the page names the section, and the long run goes on
        traceback.print_exc()
        failed = f"{type(error).__name__}: {error}"
    if not failed and not tables.get("rows"):
        failed = "the folder holds nothing that this table is made from"
    figure.unlink(missing_ok=True)
    if drawn.is_file():
        drawn.replace(figure)
    return {
        "tables": tables,
        "failed": failed,
        "seconds": perf_counter() - begin + sum(reused),
        "pairs": pairs,
        "made with": f"{os.cpu_count()} cores, Python {platform.python_version()}, numpy {np.__version__}, "
        f"scipy {scipy.__version__}",
    }


@contextmanager
def _storing(section: Section, folder: Path | None, reused: list[float]) -> Iterator[None]:
    """A context in which the records of a section's pairs are kept in a folder, if one is given.

    The seconds that reused ones took are added to a list.
    """
    if folder is None:
        yield
        return
    code = [*CODE, Path(inspect.getfile(section.run))]
    with storing(folder / f"{section.name}.jsonl", code) as store:
        yield
    reused += store.reused


def as_page(made: Mapping[Section, Record], folder: Path) -> str:
    """The text of the page, from the records of its sections and the folder of their figures."""
    minutes = sum(record["seconds"] for record in made.values()) / 60
    lines = [
        "# The paper, reproduced",
        "",
        "Tables and figures of ZoomOut (Melzi, Ren, Rodolà, Sharma, Wonka and Ovsjanikov 2019), made by "
        "`python -m benchmarks paper --data FOLDER --pairs N`, which writes this page. Errors are mean geodesic "
        "distances between a point's image and its true place, at unit area of the source, times 1000. A pair failed "
        "above 80 (130, where shapes are far from isometric). *ZoomOut* is the paper's, from the same initial map as "
        "the methods beside it, *ZoomOut\\** the same with 500 samples; `zo.match` is our match of the two "
        "shapes alone, without an initial map.",
        "",
        f"The run took {minutes:.0f} minutes.",
    ]
    for section, record in made.items():
        lines += ["", f"## {section.title}", "", f"*Published*: {section.published}"]
        if record["failed"]:
            lines += ["", f"**Could not be made**: {record['failed']}."]
        else:
            lines += ["", f"*Here*: {section.setup}".rstrip()]
            lines += [
                "",
                *(f"- {sentence.replace('*', chr(92) + '*')}" for sentence in section.reading(record["tables"])),
            ]
        for name, rows in record["tables"].items():
            lines += ["", *([] if name == "rows" else [f"{name[0].upper()}{name[1:]}:", ""]), as_markdown(rows)]
        if (folder / f"{section.name}.png").is_file():
            lines += ["", f"![{section.title}]({folder.name}/{section.name}.png)"]
        lines += [
            "",
            f"<sub>`python -m benchmarks {section.name}`, "
            + (f"`--pairs {record['pairs']}`, " if record["pairs"] else "")
            + f"{record['seconds'] / 60:.1f} minutes; {record['made with']}</sub>",
        ]
    return "\n".join(lines) + "\n"
