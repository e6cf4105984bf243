# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `zoomout outfits`: what avatars wear, onto other avatars."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from zoomout_core.assets.files import check_compression
from zoomout_core.batch import FAILED, PARTLY
from zoomout_core.cli.report import json_option
from zoomout_core.collection.dask_engine import has_dask, local_engine
from zoomout_core.collection.report import PAGE
from zoomout_core.command_options import FilePath, compress_option, detail_options, progress_bar, refusals, tell
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.presets import resolve_detail
from zoomout_core.outfits.command import dress_files, find_avatars
from zoomout_core.outfits.gltf_files import ENDINGS, GltfFiles
from zoomout_core.outfits.report import figures_of_outfits, lines_of_outfits
from zoomout_core.runtime.threads import usable_cores
from zoomout_core.translations import ENGLISH, LANGUAGES, user_locale


@click.command()
@click.argument("outfits", type=FilePath(path_type=Path))
@click.argument("avatars", metavar="AVATARS...", nargs=-1, required=True, type=FilePath(path_type=Path))
@click.option("-o", "--output", required=True, type=FilePath(path_type=Path), help="The folder for the results.")
@click.option(
    "--body",
    multiple=True,
    metavar="PATTERN",
    help=(
        "Name of meshes or materials that are parts of bodies, such as 'Body*'. May be repeated. By default, bodies "
        "are recognized by words in their names."
    ),
)
@click.option(
    "--keep",
    multiple=True,
    metavar="PATTERN",
    help="Name of meshes or materials of the outfit that keep their form, such as 'Buckle*'. May be repeated.",
)
@click.option(
    "--stiffness",
    type=click.FloatRange(0, 1),
    default=0.5,
    show_default=True,
    help="How far clothes keep their form: 0 follows every detail of the body.",
)
@click.option(
    "--gap",
    type=click.FloatRange(min=0),
    default=0.0,
    show_default=True,
    help="Minimum distance of clothes from the skin, in metres.",
)
@click.option("--workers", type=click.IntRange(min=1), help="Processes on this machine (default: one per core).")
@click.option(
    "--resume/--restart", default=True, show_default=True, help="Resume from existing results, or recompute everything."
)
@click.option(
    "--language",
    type=click.Choice((ENGLISH, *LANGUAGES)),
    help="Language of report.html (default: that of the system, if it is one of these).",
)
@click.option("--force", is_flag=True, help="Write an avatar even if its match is probably wrong.")
@compress_option
@json_option
@detail_options
def outfits(
    outfits: Path,
    avatars: tuple[Path, ...],
    output: Path,
    body: tuple[str, ...],
    keep: tuple[str, ...],
    stiffness: float,
    gap: float,
    workers: int | None,
    resume: bool,
    language: str | None,
    force: bool,
    compression: str | None,
    as_json: bool,
    **accuracy: Any,
) -> None:
    """Dress avatars in the clothes of others.

    OUTFITS is a glTF or VRM file of a dressed avatar, or a folder of them; AVATARS are files or folders of the avatars
    to dress, which keep all of their data. Clothes, hair and accessories are fitted to each avatar and bound to its
    joints. They get morph targets with the names of the avatar's, so that they follow its body. Joints of the outfit
    alone, such as those of skirts, are added to the avatar.

    Each pair of bodies is matched once, and an interrupted run resumes where it stopped. The avatars are written to
    OUTPUT/dressed/AVATAR/OUTFIT.glb, or .vrm for an avatar in VRM, which is never compressed. OUTPUT/report.html shows
    each from the front, from the back and in two poses, with the share of the cloth that is in the skin.

    The exit code is 0 if all went well, 1 if nothing did, and 3 if some did.
    """
    with refusals():
        dressed, naked = find_avatars(outfits, avatars, output, ENDINGS)
        if workers is None:
            workers = min(usable_cores(), len(dressed) + len(naked)) if has_dask() else 1
        check_compression("avatar.glb", compression)
        options = MatchOptions(**resolve_detail(**accuracy))
        with local_engine(workers, 0) as engine, progress_bar():
            locale = user_locale() if language is None else language
            files = GltfFiles(body, keep, stiffness, gap, force, compression)
            result = dress_files(dressed, naked, output, files, options, engine, resume=resume, locale=locale)
    if as_json:
        click.echo(json.dumps(figures_of_outfits(result), indent=1))
    else:
        for line in lines_of_outfits(result):
            tell(line)
        tell(f"Written to {output}; open {output / PAGE}.")
    if result.failures:
        sys.exit(PARTLY if result.worn else FAILED)
