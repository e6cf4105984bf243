# SPDX-License-Identifier: GPL-3.0-or-later
"""The common part of the commands `zoomout outfits` and `blender --command zoomout outfits`."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from zoomout_core.assets.files import inputs_of
from zoomout_core.collection.engine import Engine
from zoomout_core.collection.report import PAGE, REPORT
from zoomout_core.collection.tasks import MAPS, SHAPES
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.preparation.disk_cache import remove_shapes
from zoomout_core.mesh.formats.folders import meshes_of_all
from zoomout_core.outfits.batch import BODIES, BY_JOINTS, FITS, OutfitsResult, dress_all
from zoomout_core.outfits.dress_file import DRESSED, PICTURES, RECORDS, AvatarFiles
from zoomout_core.outfits.report import write_reports
from zoomout_core.runtime.outputs import check_inputs_outside, check_results_folder
from zoomout_core.translations import language_of

# Folder in the results that is deleted at the end.
CACHE = "cache"
# Places in the results that a run replaces.
REPLACED = REPORT, PAGE, MAPS, SHAPES, BODIES, FITS, DRESSED, PICTURES, RECORDS, BY_JOINTS, CACHE


def find_avatars(
    outfits: Path, avatars: Sequence[Path], output: Path, endings: Collection[str]
) -> tuple[list[Path], list[Path]]:
    """Find the files of outfits and of avatars, and check that results can be written to a folder.

    Raises:
        MeshError: a file or folder does not exist, or is empty, or the output is a file.
        OutputError: the folder cannot be written to, or would replace one of the files.
    """
    check_results_folder(output, REPLACED)
    found = meshes_of_all([outfits], endings), meshes_of_all(avatars, endings)
    check_inputs_outside(inputs_of(*found[0], *found[1]), output, REPLACED)
    return found


def dress_files(
    outfits: Sequence[Path],
    avatars: Sequence[Path],
    output: Path,
    files: AvatarFiles,
    options: MatchOptions,
    engine: Engine | None = None,
    *,
    resume: bool = True,
    locale: str = "",
) -> OutfitsResult:
    """Dress avatars, see `dress_all`, and write the reports.

    Args:
        outfits: files of dressed avatars.
        avatars: files of avatars to dress.
        output: folder of the results.
        files: their format, and options of the fit.
        options: options of every match.
        engine: runs the tasks; None for this process.
        resume: whether to reuse results of an earlier run.
        locale: locale whose language the page is in, such as "ja_JP"; English if there is no translation.

    Raises:
        MeshError: no outfit can be put on any avatar.
    """
    if not resume:
        for pattern in (
            f"{RECORDS}/*/*.json",
            f"{MAPS}/*/*.npz",
            f"{FITS}/*/*.npz",
            f"{SHAPES}/*.npz",
            f"{BY_JOINTS}/*/*/*.npz",
        ):
            for made in output.glob(pattern):
                made.unlink()
    result = dress_all(outfits, avatars, output, files, options, cache=output / CACHE, engine=engine)
    remove_shapes(output / CACHE)
    write_reports(result, language_of(locale))
    return result
