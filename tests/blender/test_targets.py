# SPDX-License-Identifier: GPL-3.0-or-later
"""Several targets at once."""

import bpy
import numpy as np
import pytest
from scenes import activate, add_attribute, decimate, ellipsoid, link, positions, snapshot_file, values
from turns import turns

import zoomout_core as zo
from blender_addon.jobs import Job, pause
from blender_addon.scene.selection import chosen_targets
from blender_addon.services.matching.match import prepare_match
from blender_addon.services.targets import each_target
from blender_addon.storage import stored_match
from blender_addon.storage.stored_report import transfer_report
from zoomout_core.runtime.progress import stage


@pytest.fixture
def source():
    obj = ellipsoid("Source", 4)
    add_attribute(obj.data, "height", "FLOAT", "POINT", positions(obj.data)[:, 2])
    bpy.context.scene.zoomout.source = obj
    return obj


@pytest.fixture
def targets(source):
    found = [decimate("A"), decimate("B"), decimate("C")]
    for i, obj in enumerate(found, start=1):
        obj.location.x = 3 * i
    bpy.context.view_layer.update()
    activate(*found)
    return found


@pytest.mark.slow
def test_the_active_and_all_selected_meshes_but_the_source_are_matched(source, targets):
    activate(targets[1], targets[0], source)
    assert bpy.ops.zoomout.match(k_final=30) == {"FINISHED"}
    assert [stored_match.description(obj.data) is not None for obj in (*targets, source)] == [True, True, False, False]


def test_all_targets_receive_data_in_one_undo_step(source, targets):
    targets = targets[:2]
    activate(*targets)
    bpy.ops.ed.undo_push(message="before")
    before = snapshot_file()
    assert bpy.ops.zoomout.transfer("EXEC_DEFAULT", True, k_final=30) == {"FINISHED"}
    for obj in targets:
        assert transfer_report(obj)["target"] == obj.name
        np.testing.assert_allclose(values(obj.data, "height"), positions(obj.data)[:, 2], atol=0.1)
    bpy.ops.ed.undo()
    assert snapshot_file() == before


def test_failed_target_is_named_and_others_are_kept(source, targets, capfd):
    targets[0].data.clear_geometry()
    bpy.context.view_layer.update()
    assert bpy.ops.zoomout.match(k_final=30) == {"FINISHED"}
    assert [stored_match.description(obj.data) is not None for obj in targets] == [False, True, True]
    printed = capfd.readouterr().out
    assert "'A' was left out: 'A' has no faces" in printed
    assert "Matched 2 meshes with 'Source'" in printed
    for obj in targets[1:]:
        obj.data.clear_geometry()
    bpy.context.view_layer.update()
    before = snapshot_file()
    with pytest.raises(RuntimeError, match=r"All 3 targets failed\. 'A': 'A' has no faces"):
        bpy.ops.zoomout.match(k_final=30)
    assert snapshot_file() == before


def test_nothing_is_written_before_all_are_worked_out(source, targets):
    written, order = [], []

    async def work(name):
        with stage("Working", 0.5):
            await pause()
        order.append(name)
        assert not written
        if name == "B":
            raise zo.MeshError("It is broken.")
        return lambda: written.append(name) or name

    job = Job(each_target(["A", "B", "C"], work))
    progress = [*turns(job)]
    outcome = job.result
    assert [round(one.fraction, 3) for one in progress] == [0.167, 0.5, 0.833, 1.0]
    assert progress[1].stage == "'B', 2 of 3: Working"
    assert order == ["A", "B", "C"]
    assert outcome.done == {"A": "A", "C": "C"}
    assert outcome.failed == {"B": "It is broken."}


@pytest.mark.slow
def test_a_cancelled_run_leaves_all_of_them_as_they_were(source, targets):
    before = snapshot_file()
    names = [obj.name for obj in targets]
    job = Job(each_target(names, lambda name: prepare_match(bpy.context, "Source", name, k_final=30)))
    for progress in turns(job):
        if progress.fraction > 0.7:
            break
    job.cancel()
    assert snapshot_file() == before


def test_linked_duplicates_are_done_once(source, targets):
    twin, double = link("Twin", targets[0].data), link("Double", source.data)
    bpy.context.view_layer.update()
    activate(twin, *targets, source)
    assert [obj.name for obj in chosen_targets(bpy.context, source)] == ["Twin", "B", "C"]
    activate(targets[0], twin, double, source)
    assert [obj.name for obj in chosen_targets(bpy.context, source)] == ["A", "Double"]
    activate(source)
    assert chosen_targets(bpy.context, source) == []
    with pytest.raises(RuntimeError, match="'Source' cannot be its own source"):
        bpy.ops.zoomout.match()


def test_certain_targets_help_uncertain_ones(source, targets, monkeypatch):
    from dataclasses import replace

    from blender_addon.services.matching import match as service

    asked = {}

    def agree(results, options):
        asked.update(results)
        return {**results, "B": replace(results["B"], notes=("Another candidate was taken.",))}

    monkeypatch.setattr(service, "agree", agree)
    assert bpy.ops.zoomout.match(k_final=30) == {"FINISHED"}
    assert sorted(asked) == ["A", "B", "C"]
    notes = {obj.name: stored_match.description(obj.data)["notes"] for obj in targets}
    assert notes["B"] == ["Another candidate was taken."]
    assert "Another candidate was taken." not in notes["A"]


def test_single_target_needs_no_agreement(source, targets, monkeypatch):
    from blender_addon.services.matching import match as service

    monkeypatch.setattr(service, "agree", lambda *_: pytest.fail("asked"))
    activate(targets[0])
    assert bpy.ops.zoomout.match(k_final=30) == {"FINISHED"}
