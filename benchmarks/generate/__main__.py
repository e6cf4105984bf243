# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line of the generators."""

from __future__ import annotations

from pathlib import Path

import bpy  # noqa: F401  before pymeshlab, after which it could not be imported
import click

from .characters import write_characters, write_stylised_characters
from .merged import write_merged
from .partial import write_partial
from .remeshed import write_remeshed

FROM_NOTHING = {"characters": write_characters, "characters_nonisometric": write_stylised_characters}
FROM_SETS = {"merged": write_merged, "partial": write_partial, "remeshed": write_remeshed}


@click.command()
@click.argument("name", type=click.Choice(sorted(FROM_NOTHING | FROM_SETS)))
@click.option("--output", required=True, type=click.Path(file_okay=False, path_type=Path), help="Folder to write.")
@click.option(
    "--data",
    multiple=True,
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Folder of meshes that `merged`, `partial` and `remeshed` start from; may be given several times.",
)
@click.option("--seed", default=0, show_default=True, type=click.IntRange(min=0), help="Of everything that is drawn.")
@click.option("--count", default=16, show_default=True, type=click.IntRange(min=1), help="Pairs for each class.")
def main(name: str, output: Path, data: tuple[Path, ...], seed: int, count: int) -> None:
    """Generate the set NAME of meshes with known correspondences, organised like the benchmark data.

    `characters` and `characters_nonisometric` need no input; `remeshed` takes folders of OFF files, and
    `merged` and `partial` sets with `pairs.txt`.
    """
    if name in FROM_NOTHING:
        refused = FROM_NOTHING[name](output, seed, count)
        click.echo(f"{refused} poses were drawn again because limbs touched, and the mesh was not a closed body.")
    elif data:
        FROM_SETS[name](output, data, seed, count)
    else:
        raise click.UsageError(f"{name} is made from other meshes: name their folder with --data.")


if __name__ == "__main__":
    main()
