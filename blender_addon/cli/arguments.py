# SPDX-License-Identifier: GPL-3.0-or-later
"""The arguments of the command line. The sidebar's options are read from their property definitions."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from zoomout_core.matching.presets import DETAIL
from zoomout_core.transfer.keys.key_table import CONVENTIONS
from zoomout_core.translations import ENGLISH, LANGUAGES

from ..adapters import DATA, USUAL_DATA
from ..properties.dress import DressOptions
from ..properties.match import MatchOptions
from ..properties.symmetry import DetectOptions, DirectionOptions, KeyOptions, LayerOptions, SideOptions
from ..properties.transfer import BindChoice, BindOptions, BindView, BlendOptions
from ..properties.wrap import WrapOptions
from . import NAME
from .property_arguments import add_options, number_type, path, path_name

LAYERS = tuple(name for name in LayerOptions.__annotations__ if name != "uv_layout")
CHECKS = ("shape", "weights")
# Commands that do not change the open file.
READING = ("surface", "assets", "library", "outfits")


def parse(command_line: Sequence[str]) -> argparse.Namespace:
    """Parse a command line.

    Raises:
        SystemExit: the command line is invalid, or asks for help; the usage is printed.
    """
    parser = _parser()
    options = parser.parse_args(command_line)
    if options.command in ("wrap", "dress") and not (options.source and options.targets):
        parser.error("give --source and --target")
    elif options.command == "dress" and not (options.things or options.collection):
        parser.error("give --thing or --collection")
    elif options.command == "faces" and not options.sheet.lower().endswith(".png"):
        parser.error("--sheet writes a PNG file: give a name that ends in .png")
    elif options.command == "library" and options.index and len(options.folders) != 1:
        parser.error("--index works with a single library: give one FOLDER, or leave --index out")
    elif options.command in ("match", "transfer"):
        _check_pair(parser, options)
    return options


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=f"blender --background FILE.blend --command {NAME}",
        description="Match meshes of a file across pose and topology, transfer data between them, and find their "
        "symmetries.",
    )
    commands = parser.add_subparsers(dest="command", required=True)
    _add_pair(commands.add_parser("match", help="match targets with a source, and store the matches in the file"))
    _add_transfer(
        commands.add_parser("transfer", help="transfer data from a source to targets, matching them if needed")
    )
    _add_wrap(
        commands.add_parser("wrap", help="deform targets to the shape of a source, or a source to that of a target")
    )
    _add_dress(commands.add_parser("dress", help="fit copies of a source's clothes, hair and other objects to targets"))
    _add_symmetry(commands.add_parser("symmetry", help="find the symmetry of objects, and mirror their data along it"))
    _add_carry(commands.add_parser("carry", help="transfer from the meshes of one file to those of another"))
    _add_faces(commands.add_parser("faces", help="transfer the expression keys of a head, and draw them all"))
    _add_outfits(commands.add_parser("outfits", help="dress avatars in files in the clothes of others"))
    _add_surface(commands.add_parser("surface", help="write the visible meshes of a file as one surface"))
    _add_assets(commands.add_parser("assets", help="write each asset of a file as one surface"))
    _add_library(commands.add_parser("library", help="prepare folders of characters, for Find Source"))
    for name, command in commands.choices.items():
        when = "if everything succeeds" if name == "symmetry" else "if at least one target succeeds"
        if name not in READING:
            command.add_argument(
                "--save",
                type=path_name,
                metavar="OUT.blend",
                help=f"save the file there {when}, or export it to .fbx, .glb, .gltf, .obj or .ply",
            )
        command.add_argument("--report", type=path_name, metavar="REPORT.json", help="write a report")
        command.add_argument("--in-place", action="store_true", help="allow outputs to overwrite input files")
    return parser


def _add_transfer(parser: argparse.ArgumentParser) -> None:
    """Add options of a transfer between objects."""
    _add_pair(parser)
    parser.add_argument("--data", nargs="+", choices=DATA, default=USUAL_DATA, metavar="KIND", help=", ".join(DATA))
    _add_force(parser)
    for group in (BlendOptions, BindChoice, BindOptions, BindView):
        add_options(parser, group)


def _add_wrap(parser: argparse.ArgumentParser) -> None:
    """Add options of wrapping."""
    _add_objects(parser)
    add_options(parser, MatchOptions)
    add_options(parser, WrapOptions)
    _add_force(parser)


def _add_dress(parser: argparse.ArgumentParser) -> None:
    """Add options of dressing."""
    _add_objects(parser)
    parser.add_argument(
        "--thing", action="append", dest="things", default=[], metavar="NAME", help="object; may be repeated"
    )
    parser.add_argument("--collection", metavar="NAME", help="collection of such objects")
    add_options(parser, MatchOptions)
    add_options(parser, DressOptions)
    _add_force(parser)


def _add_force(parser: argparse.ArgumentParser) -> None:
    """Add the option to use any match."""
    parser.add_argument("--force", action="store_true", help="use even a match that is probably wrong")


def _add_carry(parser: argparse.ArgumentParser) -> None:
    """Add options of a transfer between files."""
    parser.description = (
        "Transfer the data of the visible meshes in the file SOURCE to those in the file TARGET. Each file is "
        "matched as one body, unless a map is given. Supported files are .blend, .fbx, .glb, .gltf, .obj, .ply and "
        ".stl; SOURCE may also be an asset in one, such as pack.blend/Collection/Hero. Data that the targets do not "
        "use is not copied."
    )
    _add_two_files(parser)
    parser.add_argument("--data", nargs="+", choices=DATA, default=USUAL_DATA, metavar="KIND", help=", ".join(DATA))
    for group in (BlendOptions, BindChoice, BindOptions):
        add_options(parser, group)
    parser.add_argument(
        "--move-rig", action="store_true", help="bind to a copy of the armature whose bones move into the target"
    )


def _add_two_files(parser: argparse.ArgumentParser) -> None:
    """Add the files that a command transfers between, and options of their match."""
    parser.add_argument("source", metavar="SOURCE", type=path_name, help="file to copy data from")
    parser.add_argument("target", metavar="TARGET", type=path_name, help="file that receives the data")
    parser.add_argument(
        "--map",
        type=path_name,
        metavar="MAP.npz",
        help="map that `zoomout match` computed from the surfaces of both files, as written by `surface`",
    )
    parser.add_argument("--detail", choices=tuple(DETAIL), default="balanced", help="for the match, if no map is given")
    _add_force(parser)


def _add_faces(parser: argparse.ArgumentParser) -> None:
    """Add options of a transfer of expression keys."""
    parser.description = (
        "Transfer the shape keys of the visible meshes in the file SOURCE to those in the file TARGET, as `carry` "
        "does, and draw each key at full strength on both heads side by side, at rest and without modifiers. Edges "
        "that stretch much more than on the source are red, and so are faces that intersect others although they do "
        "not at rest or on the source."
    )
    _add_two_files(parser)
    parser.add_argument(
        "--sheet", required=True, type=path_name, metavar="SHEET.png", help="picture to write, a tile for each key"
    )
    parser.add_argument(
        "--key-names", choices=tuple(CONVENTIONS), help="rename the keys of the target to this convention afterwards"
    )


def _add_outfits(parser: argparse.ArgumentParser) -> None:
    """Add options of dressing avatars in files."""
    parser.description = (
        "Dress avatars in the clothes of others, as the button Dress does. OUTFITS is a file of a body, its clothes "
        "and their armature, or a folder of them; AVATARS are files or folders of the avatars to dress: .blend, .fbx, "
        ".glb and .gltf. Each pair of bodies is matched once, and an interrupted run resumes where it stopped. Avatars "
        "are written to OUT/dressed/AVATAR/OUTFIT in their own format, and OUT/report.html shows them."
    )
    parser.add_argument("outfits", metavar="OUTFITS", type=path, help="file or folder of dressed avatars")
    parser.add_argument("avatars", metavar="AVATARS", nargs="+", type=path, help="files or folders of avatars to dress")
    parser.add_argument("-o", "--output", required=True, metavar="OUT", type=path, help="the folder for the results")
    parser.add_argument(
        "--body",
        action="append",
        default=[],
        metavar="PATTERN",
        help=(
            "name of objects or materials of bodies, such as 'Body*'; may be repeated; by default, bodies are "
            "recognized by words in their names"
        ),
    )
    parser.add_argument("--format", choices=("blend", "fbx", "glb"), help="format to write, if not that of the avatar")
    parser.add_argument("--restart", action="store_true", help="compute everything again")
    parser.add_argument("--language", choices=(ENGLISH, *LANGUAGES), help="of report.html, if not that of Blender")
    parser.add_argument("--detail", choices=tuple(DETAIL), default="balanced", help="for the matches")
    add_options(parser, DressOptions)
    _add_force(parser)


def _add_surface(parser: argparse.ArgumentParser) -> None:
    """Add options of reading a file."""
    parser.description = (
        "Write the visible meshes of a file, joined, in world space and in triangles, as a PLY file, which "
        "`zoomout match` reads."
    )
    parser.add_argument("file", metavar="FILE", type=path_name, help="file, as for `carry`")
    parser.add_argument(
        "--role",
        choices=("source", "target"),
        default="target",
        help="role of the file in a transfer: a source is read with its modifiers, a target without them but in its "
        "pose (default: target)",
    )
    parser.add_argument(
        "--save", required=True, type=path_name, metavar="OUT.ply", help="path of the surface file to write"
    )


def _add_assets(parser: argparse.ArgumentParser) -> None:
    """Add options of reading the assets of a file."""
    parser.description = (
        "Write each collection and mesh object that is marked for the Asset Browser in a .blend file as a PLY file, "
        "with modifiers, in world space. If most of the file is not marked, all of its visible meshes are also "
        "written as one PLY file."
    )
    parser.add_argument("file", metavar="FILE", type=path_name, help="file, as for `carry`")
    parser.add_argument(
        "--folder", required=True, type=path_name, metavar="FOLDER", help="folder to write the surfaces to"
    )


def _add_library(parser: argparse.ArgumentParser) -> None:
    """Add options of preparing libraries."""
    parser.description = (
        "Prepare the characters in folders, so that Find Source and `zoomout find` search among them at once. Files "
        "that are prepared already are skipped unless they changed."
    )
    parser.add_argument(
        "folders",
        nargs="*",
        type=path_name,
        metavar="FOLDER",
        help="folder; the asset libraries of the Preferences if not given",
    )
    parser.add_argument(
        "--index", type=path_name, metavar="INDEX", help="folder of the index (default: .zoomout in the library)"
    )


def _add_objects(parser: argparse.ArgumentParser) -> None:
    """Add options that name a source and its targets."""
    parser.add_argument("--source", metavar="NAME", help="object to copy data from")
    parser.add_argument(
        "--target", action="append", dest="targets", default=[], metavar="NAME", help="object; may be repeated"
    )


def _add_pair(parser: argparse.ArgumentParser) -> None:
    """Add options that choose the objects to match, and the way."""
    _add_objects(parser)
    parser.add_argument("--source-collection", metavar="NAME", help="collection of the meshes to copy data from")
    parser.add_argument("--target-collection", metavar="NAME", help="collection of the meshes that receive the data")
    add_options(parser, MatchOptions)


def _check_pair(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Exit with the usage unless the options name either objects or collections."""
    objects, collections = (options.source, options.targets), (options.source_collection, options.target_collection)
    if (any(objects) and any(collections)) or not (all(objects) or all(collections)):
        parser.error("give --source and --target, or --source-collection and --target-collection")
    options.source = options.source or options.source_collection


def _add_symmetry(parser: argparse.ArgumentParser) -> None:
    """Add options of a mesh's own symmetry."""
    parser.description = (
        "Find the symmetries of objects, in any pose, and store them in the file; then mirror data along the chosen "
        "symmetry, in the order of these options. A symmetry that is already stored is reused."
    )
    parser.add_argument(
        "--object", required=True, action="append", dest="objects", metavar="NAME", help="object; may be repeated"
    )
    parser.add_argument("--detect-again", action="store_true", help="find symmetries again, even if an object has some")
    add_options(parser, DetectOptions)
    parser.add_argument("--use", type=number_type(int, 1, None), metavar="N", help="use the Nth symmetry found")
    parser.add_argument("--swap-sides", action="store_true", help="swap left and right")
    parser.add_argument("--name-sides", action="store_true", help="create vertex groups for the sides")
    add_options(parser, SideOptions)
    parser.add_argument("--symmetrise-weights", action="store_true", help="make vertex groups symmetric")
    add_options(parser, DirectionOptions)
    parser.add_argument(
        "--mirror-shape-keys",
        nargs="+",
        default=(),
        metavar="KEY",
        help=("create mirrored keys from these, as set by --key-mode"),
    )
    add_options(parser, KeyOptions)
    parser.add_argument(
        "--mirror-attributes", nargs="+", choices=LAYERS, default=(), metavar="KIND", help=", ".join(LAYERS)
    )
    add_options(parser, LayerOptions, ["uv_layout"])
    parser.add_argument(
        "--check", nargs="+", choices=CHECKS, default=(), help="finally, report how much the sides differ in these"
    )
