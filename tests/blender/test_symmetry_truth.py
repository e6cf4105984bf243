# SPDX-License-Identifier: GPL-3.0-or-later
"""A posed character with more edges on one side: mirrored data equals the truth, which is symmetric at rest."""

import bpy
import numpy as np
import pytest
from scenes import from_pydata, weight_array
from symmetric import edges_between

import zoomout_core as zo
from benchmarks.generate.lopsided import lopsided_characters
from blender_addon import mesh_data
from blender_addon.services.symmetry.layers import mirror_attributes
from blender_addon.services.symmetry.weights import symmetrise_weights
from blender_addon.storage import stored_symmetry


@pytest.fixture(scope="module")
def character():
    return next(lopsided_characters(1, seed=0))


@pytest.fixture(scope="module")
def found(character):
    """Its symmetries, in Blender's single precision."""
    surface = character.surface
    return zo.detect_symmetry(surface.with_vertices(surface.vertices.astype(np.float32)))


@pytest.fixture
def body(character, found):
    """The character as an object, with a known symmetry."""
    surface = character.surface
    obj = from_pydata("Lopsided", surface.vertices.tolist(), surface.triangles.tolist())
    stored_symmetry.write(obj, found, "X")
    return obj


@pytest.mark.slow
def test_exchange_with_an_empty_side_moves_the_data(body, character):
    mesh_data.write_weights(body, character.broken)  # the right side has none
    truth, right = character.truth.values.toarray(), character.right
    symmetrise_weights(bpy.context, body, "exchange")
    found = np.column_stack([weight_array(body, name) for name in character.truth.labels])
    off = np.abs(found - truth)[right].sum(axis=1) / 2
    assert np.median(off) < 0.02
    assert off.mean() < 0.06  # some fingers and toes may be taken for their neighbours
    assert found[~right].sum(axis=1).mean() < 0.04


def test_marks_around_limbs_are_mirrored(body, character):
    surface, labels = character.surface, character.truth.labels
    heaviest = np.asarray(character.truth.values.argmax(axis=1)).ravel()

    def cuffs(side):
        """(e,) edges around the hand and the foot of a side."""
        limbs = [i for i, name in enumerate(labels) if name.endswith(side) and name.startswith(("hand", "foot"))]
        inside = np.isin(heaviest[surface.triangles], limbs).sum(axis=1) > 1
        return edges_between(body.data, inside)

    left, right = cuffs(".L"), cuffs(".R")
    body.data.edges.foreach_set("use_seam", left)
    mirror_attributes(bpy.context, body, ["edges"])
    seams = np.array([edge.use_seam for edge in body.data.edges])
    assert seams[left].all()
    middles = surface.vertices[np.array([edge.vertices[:] for edge in body.data.edges])].mean(axis=1)
    for some, others in ((seams & ~left, right), (right, seams & ~left)):  # neither astray nor with gaps
        off = np.linalg.norm(middles[some][:, None] - middles[others], axis=2).min(axis=1)
        assert np.percentile(off, 90) < 0.03  # metres; the mesh's edges are half as long
    mirror_attributes(bpy.context, body, ["edges"], "exchange")
    exchanged = np.array([edge.use_seam for edge in body.data.edges])
    assert 0.7 < exchanged.sum() / seams.sum() < 1.4
