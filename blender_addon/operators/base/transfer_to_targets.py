# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfer to several targets by the options of an operator."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from bpy.types import Context

from ... import services
from ...adapters import Binding
from ...jobs import Work
from ...viewport import preview


async def transfer_to_targets(
    operator: Any, context: Context, source_of: Mapping[str, str], data: Collection[str], binding: Binding | None
) -> list[dict[str, Any]]:
    """Transfer data to targets, and bind these if a binding is given; targets that fail are reported.

    Args:
        operator: a `ModalOperator` with the options of a match and of a transfer.
        context: Blender's.
        source_of: the source of each target, by name.
        data: the kinds of data; with a binding, vertex groups in any case.
        binding: how to bind the targets.

    Returns:
        The reports of the targets that received data.
    """
    settings, options = operator.settings(), operator.match_options()
    undo_step = operator.adds_undo_steps and len(source_of) == 1
    use = services.matching.made_match.MatchUse(operator.options.is_repeat, remedy=operator.remedy, undo_step=undo_step)

    def work(target: str) -> Work[services.targets.Write[dict[str, Any]]]:
        return services.transfer.prepare_transfer(
            context, source_of[target], target, data, settings, binding, use, **options
        )

    outcome = await services.targets.each_target(list(source_of), work)
    preview.clear()  # it would hide the result
    operator.report_failed(outcome)
    return list(outcome.done.values())
