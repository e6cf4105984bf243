"""Transfer data from a source to the active mesh, along their match."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.progress import Steps, drain, spread, within
from zoomout_core.transfer import Attribute
from zoomout_core.transfer import transfer_steps as transfer_steps_of
from zoomout_core.transfer.weights import sum_to_one

from .. import mesh_data, stored_match, stored_report
from ..evidence import matching_steps
from ..mesh_data import Layer, Role, SourceData
from ..pair import ObjectPair, check_unedited, choose_source, find_mesh, read_pair, users_of_mesh
from ..properties import MatchOptions, SourceName, TransferOptions, option_label, take_settings
from .stepped import SteppedOperator

# The kinds of data that can be chosen, as options and as lists in the report, and what one of them is called.
NOUNS = {
    "uv_maps": "UV map",
    "color_attributes": "color attribute",
    "attributes": "attribute",
    "vertex_groups": "vertex group",
    "materials": "material",
}
DATA = tuple(NOUNS)
# Part of the progress that matching takes, where there is no match yet.
MATCHING = 0.8


class ZOOMOUT_OT_transfer(SourceName, MatchOptions, TransferOptions, SteppedOperator):
    bl_idname = "zoomout.transfer"
    bl_label = "Transfer"
    bl_description = (
        "Transfer data from the source to the active mesh along their match; they are matched first where they "
        "are not yet. The source is chosen as for matching, else it is the one that was matched"
    )
    bl_options = {"REGISTER", "UNDO"}

    def steps(self, context: Context) -> Steps[str]:
        take_settings(self, context.scene.zoomout)
        names = _choose_names(context, self.source)
        report = yield from transfer_steps(context, *names, self.data(), **self.match_options())
        return summary(report)


def _choose_names(context: Context, named: str) -> tuple[str, str]:
    target = context.active_object
    kept = stored_match.description(target.data) or {"source": ""}
    return choose_source(context, target, named, otherwise=kept["source"]).name, target.name


def transfer_objects(
    context: Context, source: Object, target: Object, data: Collection[str] = DATA, **match_options: Any
) -> dict[str, Any]:
    """Transfer data between two mesh objects, along the match that is kept on the target, or a new one.

    Args:
        context: Blender's; both objects are in its scene.
        source: has the data; read as its modifiers leave it.
        target: receives it.
        data: which kinds of it, of `DATA`.
        match_options: of `match_objects`, where no match of these two is kept.

    Returns:
        The report, see `stored_report.transfer_report`.

    Raises:
        MeshError: something cannot be transferred; nothing was written.
    """
    return drain(transfer_steps(context, source.name, target.name, data, **match_options))


def transfer_steps(
    context: Context, source_name: str, target_name: str, data: Collection[str], **match_options: Any
) -> Steps[dict[str, Any]]:
    """`transfer_objects` as a generator, which holds no Blender data while it is suspended."""
    pair = read_pair(context, source_name, target_name)
    kept = stored_match.read(find_mesh(context, target_name).data, pair)
    plan = _plan(context, pair, data)
    match: stored_match.Match
    if kept is None:
        match = yield from within(matching_steps(context, pair, **match_options), 0, MATCHING)
    else:
        match = kept
        plan.notes.extend(_unused_settings(kept, match_options))
    yield from within(_compute(plan, match, pair), MATCHING if kept is None else 0, 1)

    _, target = check_unedited(context, pair)
    if kept is None:
        stored_match.write(target.data, match, pair, match_options)
    _write(target, plan)
    return _write_report(target, plan, match, pair, users_of_mesh(context, target))


def _unused_settings(kept: stored_match.StoredMatch, settings: dict[str, Any]) -> list[str]:
    """A sentence about settings that the kept match was not made with, as far as is known."""
    unused = [name for name, value in settings.items() if name not in kept.settings or kept.settings[name] != value]
    if not unused:
        return []
    labels = ", ".join(option_label(name) for name in unused)
    return [f"The match that was made before was used as it is: to use other settings ({labels}), match again."]


# --- what is to be done -------------------------------------------------------------------------------------


@dataclass
class Plan:
    """What is transferred: with the source's values at first, then with the target's.

    Attributes:
        source: what the source has.
        layers: those of its layers that were chosen.
        weights: the chosen vertex groups, if there are any.
        sharing: how these share a vertex among them and with locked groups, see `weights.mix_weights`.
        face_slots: each face's slot among the source's materials, if materials were chosen.
        skipped: a reason for each name that is not transferred.
        notes: sentences for the user.
    """

    source: SourceData
    layers: list[Layer]
    weights: Attribute | None = None
    sharing: dict[str, Any] = field(default_factory=dict)
    face_slots: Attribute | None = None
    skipped: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def _plan(context: Context, pair: ObjectPair, data: Collection[str]) -> Plan:
    """Choose from what the source has, and see that the target has room for it."""
    if unknown := set(data).difference(DATA):
        raise ValueError(f"There is no data called {', '.join(sorted(unknown))}: choose from {', '.join(DATA)}.")
    source, target = find_mesh(context, pair.source_name), find_mesh(context, pair.target_name)
    found = mesh_data.read_source_data(source, context.evaluated_depsgraph_get())
    plan = Plan(found, [layer for layer in found.layers if layer.role.value in data])
    plan.skipped |= found.without_a_way
    if Role.GENERIC.value in data:
        plan.skipped |= found.skipped
    if "vertex_groups" in data and found.weights.labels:
        _plan_weights(plan, source, target)
    if "materials" in data and found.materials:
        plan.face_slots = found.face_slots
    if not plan.layers and plan.weights is None and plan.face_slots is None:
        raise zo.MeshError(f"'{source.name}' has none of the data that is to be transferred: choose other data.")
    _check_uv_maps(plan, target)
    _check_names(plan, target)
    return plan


def _plan_weights(plan: Plan, source: Object, target: Object) -> None:
    weights, locked = plan.source.weights, mesh_data.locked_groups(target)
    open_columns = [i for i, name in enumerate(weights.labels) if name not in locked]
    closed = [name for name in weights.labels if name in locked]
    plan.skipped |= dict.fromkeys(closed, "the target's vertex group is locked")
    if not open_columns:
        return
    if weights.values.nnz == 0:
        plan.notes.append(f"As its modifiers leave it, '{source.name}' has no weights: its vertex groups arrive empty.")
    labels = tuple(weights.labels[i] for i in open_columns)
    hidden = [name for name in labels if name in target.data.attributes]
    if hidden:
        plan.notes.append(
            f"'{target.name}' has attributes with the names of vertex groups ({', '.join(hidden)}): rename them, "
            "or modifiers may confuse the two."
        )
    plan.weights = replace(weights, values=weights.values[:, open_columns], labels=labels)
    deforming = _deforming_groups(plan, source, target)
    columns = [i for i, name in enumerate(weights.labels) if name in deforming]
    plan.sharing["normalised"] = np.array([name in deforming for name in labels])
    plan.sharing["sums"] = weights.values[:, columns].sum(axis=1)
    held = locked & deforming
    if held:
        present = mesh_data.read_weights(target, target.data)
        columns = [i for i, name in enumerate(present.labels) if name in held]
        plan.sharing["room"] = np.clip(1 - present.values[:, columns].sum(axis=1), 0, 1)


def _deforming_groups(plan: Plan, source: Object, target: Object) -> set[str]:
    """The groups that share a vertex among them: those of bones, or of a skin without bones.

    What an armature does not use may be masks, each for itself; but masks seldom sum to one on every vertex.
    """
    weights = plan.source.weights
    bones = mesh_data.deforming_bones(source) | mesh_data.deforming_bones(target)
    if bones.intersection(weights.labels) or weights.values.nnz == 0:
        return bones
    skin = sum_to_one(weights.values)
    plan.notes.append(
        f"No armature has bones with the names of the vertex groups of '{source.name}', which "
        + ("sum to one on every vertex: they were taken for skin weights." if skin else "were taken for masks.")
    )
    return set(weights.labels) if skin else set()


def _check_uv_maps(plan: Plan, target: Object) -> None:
    names = {layer.attribute.name for layer in plan.layers if layer.role is Role.UV_MAP}
    count = len(names.union(target.data.uv_layers.keys()))
    if count > mesh_data.MOST_UV_MAPS:
        raise zo.MeshError(
            f"'{target.name}' would have {count} UV maps, and Blender's limit is {mesh_data.MOST_UV_MAPS}: "
            "remove some from it, or from the source."
        )


def _check_names(plan: Plan, target: Object) -> None:
    attributes = target.data.attributes
    for layer in plan.layers:
        name = layer.attribute.name
        if name not in attributes and name in target.vertex_groups:
            raise zo.MeshError(
                f"'{name}' is an attribute of the source but a vertex group of '{target.name}': rename one of them."
            )
        if name in attributes and not mesh_data.fits(attributes[name], layer):
            plan.notes.append(f"{name}: replaced an attribute of '{target.name}' that was of another type.")


# --- doing it -----------------------------------------------------------------------------------------------


def _compute(plan: Plan, match: stored_match.Match, pair: ObjectPair) -> Steps[None]:
    """Put the target's values in place of the source's."""
    count = len(plan.layers) + 2

    def carried(attribute: Attribute, number: int, what: str, **options: Any) -> Steps[Attribute]:
        steps = transfer_steps_of(attribute, match, pair.source, pair.target, **options)
        result = yield from spread(steps, number / count, (number + 1) / count, f"Transferring {what}")
        plan.notes.extend(result.notes)
        return result

    for i, layer in enumerate(plan.layers):
        attribute = yield from carried(layer.attribute, i, f"'{layer.attribute.name}'")
        plan.layers[i] = replace(layer, attribute=attribute)
    if plan.weights is not None:
        plan.weights = yield from carried(plan.weights, count - 2, "vertex groups", **plan.sharing)
    if plan.face_slots is not None:
        plan.face_slots = yield from carried(plan.face_slots, count - 1, "materials")


def _write(target: Object, plan: Plan) -> None:
    for layer in plan.layers:
        mesh_data.write_layer(target.data, layer)
    written = {layer.attribute.name for layer in plan.layers}
    mesh_data.write_active_layers(target.data, plan.source.active.among(written))
    if plan.weights is not None:
        mesh_data.write_weights(target, plan.weights)
    if plan.face_slots is not None:
        mesh_data.write_materials(target, plan.source.materials, plan.face_slots)
    target.data.update()


def _write_report(
    target: Object, plan: Plan, match: stored_match.Match, pair: ObjectPair, users: int
) -> dict[str, Any]:
    shared = f"The mesh '{target.data.name}' is shared by {users} objects, which all received the data."
    report = {
        "source": pair.source_name,
        "target": pair.target_name,
        "written": _written(plan),
        "skipped": plan.skipped,
        "notes": [*match.notes, *plan.notes, *([shared] if users > 1 else [])],
        "vertices": len(match.confidence),
        "low_confidence": stored_match.low_confidence(match.confidence),
    }
    stored_report.write(target, report)
    return report


def _written(plan: Plan) -> dict[str, list[str]]:
    written: dict[str, list[str]] = {kind: [] for kind in DATA}
    for layer in plan.layers:
        written[layer.role.value].append(layer.attribute.name)
    if plan.weights is not None:
        written["vertex_groups"].extend(plan.weights.labels)
    if plan.face_slots is not None:
        used = np.unique(plan.face_slots.values)
        written["materials"].extend(plan.source.materials[slot] or "(none)" for slot in used)
    return written


def summary(report: dict[str, Any]) -> str:
    """The report in one sentence."""
    written = ", ".join(_count(len(names), NOUNS[kind]) for kind, names in report["written"].items() if names)
    skipped = f"; {len(report['skipped'])} skipped" if report["skipped"] else ""
    return (
        f"Transferred {written} from '{report['source']}' to '{report['target']}'{skipped}; "
        f"{report['low_confidence']} of {report['vertices']} vertices are of low confidence"
    )


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
