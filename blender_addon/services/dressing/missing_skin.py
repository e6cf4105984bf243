# SPDX-License-Identifier: GPL-3.0-or-later
"""Complete a source that lacks skin below its clothes, such as an avatar of a game, by these clothes."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, vstack

import zoomout_core as zo
from zoomout_core.matching.report.verdict import AMBER
from zoomout_core.messages import message, warning
from zoomout_core.outfits.joint_match import LOOK_FOR_SLIDES, JointMatch
from zoomout_core.transfer.dressing.missing_skin import PLACED_BY_BONES, complete_body
from zoomout_core.transfer.rigging.joint_map import RiggedBody, SharedJoints
from zoomout_core.transfer.rigging.skinning import renumber_bones

from .fit import body_without_worn, rigged_bodies
from .read import Fitting
from .worn_weights import weights_of_bones


class CompletedFitting(NamedTuple):
    """A fitting whose source is completed by clothes, and the match of the bodies by their joints."""

    fitting: Fitting
    by_joints: JointMatch


def complete_fitting(fitting: Fitting) -> CompletedFitting | None:
    """Complete the source by the clothes that have no skin below them.

    Returns:
        None if its skin is complete, or the armatures have too few humanoid bones in common.
    """
    source, target = rigged_bodies(fitting)
    if source is None or target is None:
        return None
    assert fitting.weights is not None
    weights, names = fitting.weights, source.bones.names
    worn = [
        (each.shape, weights_of_bones(groups, names))
        for each, groups in zip(fitting.worn, weights.worn, strict=True)
        if groups is not None and not each.is_hair and isinstance(each.shape, zo.Surface)
    ]
    body, is_body = body_without_worn(fitting)
    bare = RiggedBody(body, source.bones, csr_array(source.weights[is_body]))
    clothed = complete_body(bare, [shape for shape, _ in worn], [given for _, given in worn])
    joints = None if clothed is None else SharedJoints.of(clothed.body, target)
    if clothed is None or joints is None:
        return None
    of_source = weights.source
    labels = tuple(dict.fromkeys([*of_source.labels, *names]))
    columns = np.array([labels.index(name) for name in names], dtype=np.int64)
    of_skin = renumber_bones(csr_array(of_source.values[is_body]), np.arange(len(of_source.labels)), len(labels))
    of_cloth = renumber_bones(csr_array(clothed.body.weights[clothed.skin :]), columns, len(labels))
    groups = replace(of_source, labels=labels, values=csr_array(vstack([of_skin, of_cloth], format="csr")))
    completed = replace(
        fitting,
        source=clothed.body.surface,
        is_body=np.ones(len(clothed.body.surface.vertices), dtype=bool),
        weights=replace(weights, source=groups),
        clothed=clothed,
    )
    sentence = warning(PLACED_BY_BONES, share=clothed.share)
    return CompletedFitting(completed, JointMatch(joints.map(), zo.Verdict(AMBER, sentence, message(LOOK_FOR_SLIDES))))
