# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables of transferred data, most of them beside Blender's own."""

from __future__ import annotations

from pathlib import Path

import click

from benchmarks import rigs as rigs_table
from benchmarks import wrap as wrap_table
from benchmarks.command import FILE, READ_FILE, READ_FOLDER, main, pictures_of, table, table_of_sets
from benchmarks.tables import Tables, write_page


@table_of_sets(click.option("--slow", is_flag=True, help="Include non-rigid ICP, which takes minutes for each pair."))
def faces(data: Path, pairs: int | None, slow: bool) -> Tables:
    """Expression keys on other heads, beside methods that get the true landmarks."""
    from benchmarks import faces as faces_tables  # it needs trimesh

    return faces_tables.run(data, pairs, slow)


@table_of_sets(click.option("--judging", is_flag=True, help="Leave out the packs that set the numbers of the search."))
def library(data: Path, pairs: int | None, judging: bool) -> Tables:
    """The right asset and family of posed and remeshed queries in a library, refusals, and seconds per query."""
    from benchmarks import library as library_table  # it starts Blender, which the other tables do without

    return library_table.run(data, pairs, judging)


@table_of_sets()
def transfer(data: Path, pairs: int | None) -> Tables:
    """Error of transferred UVs, weights, colours and other attributes, beside Data Transfer and MeshLab."""
    from benchmarks import transfer as transfer_tables  # it starts Blender, which the other tables do without

    return transfer_tables.run(data, pairs)


@table_of_sets(pictures_of("the worst cases of each kind"))
def characters(data: Path, pairs: int | None, pictures: Path | None) -> Tables:
    """Bones, limbs and positions on game characters and dressed bodies, beside Blender's Data Transfer."""
    from benchmarks import characters as character_tables  # it starts Blender

    return character_tables.run(data, pairs, pictures)


@table_of_sets(
    pictures_of("the worst cases of each kind"),
    click.option("--left-out", is_flag=True, help="Judge the verdict on pairs that set none of its numbers."),
)
def everywhere(data: Path, pairs: int | None, pictures: Path | None, left_out: bool) -> Tables:
    """Lost parts, wrong limbs and fingers, torn edges, bindings, and the verdict, beside Data Transfer."""
    from benchmarks import everywhere as everywhere_tables  # it starts Blender

    return everywhere_tables.run(data, pairs, pictures, left_out)


@table_of_sets(pictures_of("each character"))
def binding(data: Path, pairs: int | None, pictures: Path | None) -> Tables:
    """Error of posed characters that are bound to a rig, in other poses, beside the true weights."""
    from benchmarks import binding as binding_table  # it starts Blender

    return binding_table.run(data, pairs, pictures)


@table(
    click.option(
        "--table",
        "tables",
        type=click.Choice(["links", "levels", "bakes", "compression", "loaders"]),
        multiple=True,
        help="Make this alone.",
    ),
    pictures_of("the bakes"),
    click.option(
        "--node-modules",
        type=READ_FOLDER,
        help="Also open files in Babylon.js and three.js, and validate them; see loaders.mjs.",
    ),
    click.option("--panda", type=READ_FILE, help="Also open files in Panda3D, by this Python program, which has it."),
    click.option(
        "--godot",
        type=READ_FILE,
        help="Also import files into Godot, by this program of Godot 3, such as godot3-server.",
    ),
    click.option("--page", type=FILE, help="Write the tables to this Markdown file."),
)
def production(
    tables: tuple[str, ...],
    pictures: Path | None,
    node_modules: Path | None,
    panda: Path | None,
    godot: Path | None,
    page: Path | None,
) -> Tables:
    """Live links beside the operator, levels beside Blender's, bakes beside Cycles, and files in other programs."""
    from benchmarks import production as production_tables  # it starts Blender

    made = production_tables.run(tables or production_tables.TABLES, pictures, node_modules, panda, godot)
    if page is not None:
        write_page(made, page)
    return made


@main.command()
@click.argument("file", type=FILE)
def limb(file: Path) -> None:
    """Draw the checker on an arm with a seam, as transferred by this project and by Data Transfer, to an image file."""
    from benchmarks.transfer import picture

    picture.draw(file)


@table_of_sets(pictures_of("each pair"))
def wrap(data: Path, pairs: int | None, pictures: Path | None) -> Tables:
    """The source's shape on the target's topology: distance, distortion and folds, beside closest points."""
    return wrap_table.run(data, pairs, pictures)


@table_of_sets(
    pictures_of("each case"),
    click.option("--kind", "kinds", multiple=True, help="Only cases of this kind, such as 'strict build'."),
    click.option("--way", "ways", multiple=True, help="Only this method, such as 'dress'."),
    click.option("--records", type=FILE, help="Keep cases that are done here, and resume."),
)
def outfits(
    data: Path,
    pairs: int | None,
    pictures: Path | None,
    kinds: tuple[str, ...],
    ways: tuple[str, ...],
    records: Path | None,
) -> Tables:
    """Outfits on other bodies: error, penetration of the skin, distortion, keys and bones, beside Surface Deform."""
    from benchmarks.outfits import table as outfits_table  # it starts Blender, which the other tables do without

    for chosen, known in ((kinds, outfits_table.KINDS), (ways, outfits_table.EVERY_WAY)):
        if not set(chosen) <= set(known):
            raise click.UsageError(f"{', '.join(chosen)}: give some of {', '.join(known)}.")
    kinds, ways = kinds or outfits_table.KINDS, ways or outfits_table.EVERY_WAY
    return outfits_table.run(data, pairs, pictures, kinds, ways, records)


@table_of_sets(pictures_of("each joint"))
def correctives(data: Path, pairs: int | None, pictures: Path | None) -> Tables:
    """Shape keys that bones drive, on bodies of other builds, poses and rigs, beside copied vectors."""
    from benchmarks import correctives as correctives_table  # it starts Blender

    return correctives_table.run(data, pairs, pictures)


@table_of_sets()
def rigs(data: Path, pairs: int | None) -> Tables:
    """Joints and posed surface of rigs moved to other builds, beside scaling and the surface around each joint."""
    return rigs_table.run(data, pairs)
