"""The command `blender --command zoomout`, for pipelines: matching and transferring without a window.

blender --background FILE.blend --command zoomout transfer --source Hero --target Scan --save OUT.blend
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import bpy
from bpy.types import Context

import zoomout_core as zo
from zoomout_core.progress import Steps, drain

from . import stored_match
from .cargo import DATA, FILL_BELOW, USUAL_DATA, Settings, parse_group_names
from .operators.match import worked_out_match_steps
from .operators.transfer import worked_out_transfer_steps
from .targets import Write, each_target_steps

NAME = "zoomout"
# What the process ends with: argparse's 2 is for a command line that cannot be understood.
DONE, FAILED = 0, 1
STARTS = ("auto", "landmarks", "proximity", "nearest", "same_order", "file")

Result = TypeVar("Result")

_handle: Any = None


def register() -> None:
    """Make the command known to Blender."""
    global _handle
    _handle = bpy.utils.register_cli_command(NAME, main)


def unregister() -> None:
    """Take it away again."""
    bpy.utils.unregister_cli_command(_handle)


def main(arguments: Sequence[str]) -> int:
    """Run the command on the file that is open.

    Args:
        arguments: what follows the command's name.

    Returns:
        0 if all targets were done, 1 if some or all were not, 2 if the arguments cannot be understood.
    """
    try:
        options = _parser().parse_args(arguments)
    except SystemExit as ended:  # after --help, or with the usage on the terminal
        return int(ended.code or 0)
    report: dict[str, Any] = {"command": options.command, "source": options.source, "targets": {}}
    try:
        _check_paths(options)
        report["targets"] = options.run(bpy.context, options)
        failed = [f"'{name}': {entry['error']}" for name, entry in report["targets"].items() if "error" in entry]
        if options.save and len(failed) < len(report["targets"]):
            bpy.ops.wm.save_as_mainfile(filepath=str(Path(options.save).resolve()), copy=True)
            report["saved"] = options.save
    except (ValueError, RuntimeError) as error:  # the latter are Blender's own, as of a disk that is full
        report["error"] = str(error)
        failed = [report["error"]]
    for name in report["targets"]:
        print(f"zoomout: {options.command} to '{name}' {'failed' if 'error' in report['targets'][name] else 'done'}")
    for reason in failed:
        print(f"zoomout: {reason}", file=sys.stderr)
    if options.report:
        Path(options.report).write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    return FAILED if failed else DONE


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=f"blender --background FILE.blend --command {NAME}",
        description="Match meshes of a file across pose and topology, and transfer data between them.",
    )
    commands = parser.add_subparsers(dest="command", required=True)
    match = commands.add_parser("match", help="match targets with a source, and keep the matches in the file")
    _add_common(match)
    match.set_defaults(run=_match)
    transfer = commands.add_parser("transfer", help="transfer data from a source to targets, matching them if needed")
    _add_common(transfer)
    transfer.add_argument("--data", nargs="+", choices=DATA, default=USUAL_DATA, metavar="KIND", help=", ".join(DATA))
    transfer.add_argument("--fill-below", type=float, default=FILL_BELOW, help="confidence below which to fill in")
    transfer.add_argument("--mode", choices=("mix", "missing"), default="mix", help="replace, or only add what lacks")
    transfer.add_argument("--factor", type=float, default=1.0, help="how much is taken of what is transferred")
    transfer.add_argument("--mask-group", default="", metavar="NAME", help="vertex group that limits where")
    transfer.add_argument("--limit", type=int, default=0, help="most weights of a vertex; 0: as on the source")
    transfer.add_argument("--flip-names", action="store_true", help="vertex groups change sides")
    transfer.add_argument("--group-names", default="", metavar="'OLD = NEW, …'", help="new names of vertex groups")
    transfer.set_defaults(run=_transfer)
    return parser


def _add_common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--source", required=True, metavar="NAME", help="object that has the data")
    parser.add_argument(
        "--target", required=True, action="append", dest="targets", metavar="NAME", help="object; may be repeated"
    )
    parser.add_argument("--initial", choices=STARTS, default="auto", help="what the match starts from")
    parser.add_argument("--map-file", default="", metavar="MAP.npz", help="with --initial file: by `zoomout match`")
    parser.add_argument("--exact-landmarks", action="store_true", help="hit the landmarks of the file exactly")
    parser.add_argument("--k-final", type=int, default=argparse.SUPPRESS, help="how many eigenfunctions to refine to")
    parser.add_argument("--same-up", action="store_true", help="both stand upright along Z: evidence")
    parser.add_argument("--no-names", action="store_true", help="shared names of groups and materials say nothing")
    parser.add_argument("--save", metavar="OUT.blend", help="save the file there when at least one target is done")
    parser.add_argument("--report", metavar="REPORT.json", help="write what was done")


def _check_paths(options: argparse.Namespace) -> None:
    """Raise a MeshError if the results could not be written."""
    for path in filter(None, (options.save, options.report)):
        if not Path(path).resolve().parent.is_dir():
            raise zo.MeshError(f"There is no folder {Path(path).resolve().parent}: create it, or write elsewhere.")


def _match_options(options: argparse.Namespace) -> dict[str, Any]:
    """Arguments of `match_objects`."""
    if options.initial == "nearest":
        return {"initial": "nearest"}
    known = {name: getattr(options, name) for name in ("initial", "map_file", "exact_landmarks", "same_up")}
    size = {"k_final": options.k_final} if "k_final" in options else {}
    return {**known, **size, "names": not options.no_names}


def _match(context: Context, options: argparse.Namespace) -> dict[str, Any]:
    """Match, and report."""

    def work(target: str) -> Steps[Write[stored_match.Match]]:
        return worked_out_match_steps(context, options.source, target, **_match_options(options))

    def entry(match: stored_match.Match) -> dict[str, Any]:
        return {
            "vertices": len(match.confidence),
            "low_confidence": stored_match.low_confidence(match.confidence),
            "mean_confidence": float(match.confidence.mean()),
            "certainty": match.certainty if isinstance(match, zo.MatchResult) else None,
            "notes": list(match.notes),
        }

    return _reports(options.targets, work, entry)


def _transfer(context: Context, options: argparse.Namespace) -> dict[str, Any]:
    """Transfer, and report."""
    names = ("fill_below", "mode", "factor", "mask_group", "limit", "flip_names")
    chosen = {name: getattr(options, name) for name in names}
    settings = Settings(**chosen, group_names=parse_group_names(options.group_names))

    def work(target: str) -> Steps[Write[dict[str, Any]]]:
        matching = _match_options(options)
        return worked_out_transfer_steps(context, options.source, target, options.data, settings, **matching)

    return _reports(options.targets, work, dict)


def _reports(
    targets: Sequence[str],
    work: Callable[[str], Steps[Write[Result]]],
    entry: Callable[[Result], dict[str, Any]],
) -> dict[str, Any]:
    """What was done on each target, or why it was not, by its name."""
    outcome = drain(each_target_steps(targets, work))
    done = {name: entry(result) for name, result in outcome.done.items()}
    failed = {name: {"error": reason} for name, reason in outcome.failed.items()}
    return {name: (done | failed)[name] for name in targets}
