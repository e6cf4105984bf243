# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfer of a template's data to every mesh of its collection."""

from __future__ import annotations

from collections.abc import Sequence

from zoomout_core.collection.collection import CollectionResult
from zoomout_core.collection.engine import Engine, Failure, Task, run_tasks
from zoomout_core.collection.tasks import MESHES, place_of_map, transfer_pair
from zoomout_core.collection.through_blender import transfer_pair_through_blender
from zoomout_core.collection.transfer_records import TRANSFER_RECORDS, PairTransfer, TransferOutcome
from zoomout_core.matching.report.verdict import check_verdict
from zoomout_core.mesh.errors import MeshError
from zoomout_core.messages import message_of


def transfer_template(
    result: CollectionResult,
    template: str,
    kinds: Sequence[str],
    ending: str,
    engine: Engine,
    blender: str | None = None,
    force: bool = False,
    move_rig: bool = False,
) -> dict[str, TransferOutcome]:
    """Transfer a template's data to all shapes that it is matched with, into the folder `meshes` of the results.

    Args:
        result: the collection, whose failures grow by those of the transfer.
        template: the name of the shape that has the attributes.
        kinds: kinds of data, from `assets.transfer_asset.KINDS`.
        ending: extension of the files, such as glb.
        engine: an engine with access to the folder of the results.
        blender: Blender's program, for shapes that Blender read, see `mesh.blender_files.blender_command`.
        force: transfer along maps that are probably wrong, too.
        move_rig: move the joints or bones of the template into each mesh, which keeps its size.

    Returns:
        The outcome for each mesh that was written.
    """
    names = {f"transfer to {pair.target}": pair for pair in result.records if pair.source == template}
    source = result.items[template]
    tasks = []
    for key, pair in names.items():
        try:
            check_verdict(result.verdict(pair), force)
        except MeshError as error:
            result.failures[key] = message_of(error)
            continue
        target, output = result.items[pair.target].file.absolute(), result.folder / MESHES / f"{pair.target}.{ending}"
        transfer = PairTransfer(
            source.file.absolute(),
            target,
            result.folder / place_of_map(pair),
            output,
            tuple(kinds),
            result.folder / TRANSFER_RECORDS / f"{pair.target}.json",
            move_rig,
        )
        if source.original is None:
            tasks.append(Task(key, transfer_pair, (transfer,)))
        else:
            tasks.append(Task(key, transfer_pair_through_blender, (transfer, blender)))
    received = {}
    for done in run_tasks(engine, tasks, lambda ended: f"Transferring {ended} of {len(tasks)}"):
        if isinstance(done.result, Failure):
            result.failures[done.key] = done.result.message
        else:
            received[names[done.key].target] = done.result
    return received
