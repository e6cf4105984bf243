# SPDX-License-Identifier: GPL-3.0-or-later
"""While a match is refined, the view shows the places of the best candidate roughly."""

import threading
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from scenes import snapshot_file

import zoomout_core as zo
from blender_addon import jobs
from blender_addon.jobs import Job, watching
from blender_addon.operators.base.modal_operator import ModalOperator
from blender_addon.services.matching.match import prepare_match
from blender_addon.viewport import overlay, preview
from zoomout_core.colors import place_colors
from zoomout_core.runtime.progress import advance, show_outlines


class Refining:
    """A match that shows each of some maps (n,) of all vertices as soon as it may go on."""

    def __init__(self, match, maps):
        self.match, self.maps, self.error = match, maps, None
        self.shown, self.may_end = threading.Event(), threading.Event()

    def __call__(self, source, target, **options):
        for vertex in self.maps:
            show_outlines(lambda vertex=vertex: ((np.arange(len(vertex)), vertex),))
        self.shown.set()
        while not self.may_end.wait(0.01):
            advance(0.5)
        if self.error is not None:
            raise self.error
        return self.match(source, target, k_final=30, samples=200)


@pytest.fixture
def begin(monkeypatch):
    """Start to match the target with the source as in a window, until the first look is shown."""
    match, begun = zo.match, []

    def begin_match(*maps, show_preview=True):
        refining = Refining(match, maps)
        monkeypatch.setattr(zo, "match", refining)
        job = Job(prepare_match(bpy.context, "Source", "Target", show_preview=show_preview))
        begun.append(job)
        while not refining.shown.is_set():
            assert not job.advance(0.01)
        assert not job.advance(0)
        return job, refining

    yield begin_match
    for job in begun:
        job.cancel()
    preview.clear()


def end(job, refining):
    refining.may_end.set()
    while not job.advance(0.01):
        pass
    return job.result


def shown():
    return {overlay.find(one.object_uid).name: one.values for one in overlay.overlays()}


def test_best_candidate_is_shown_as_preliminary(source, target, begin):
    count, before = len(target.data.vertices), snapshot_file()
    begin(np.arange(count)[::-1].copy(), np.arange(count))
    current = preview.preview_of(target)
    assert current.preliminary
    assert preview.legend(current) == preview.PRELIMINARY
    assert preview.caption()[0] == "Matching Colors, preliminary: ESC cancels the match"
    points = np.array([source.matrix_world @ vertex.co for vertex in source.data.vertices])
    assert set(shown()) == {"Source", "Target"}
    np.testing.assert_allclose(shown()["Source"], place_colors(points, points), atol=1e-6)
    np.testing.assert_allclose(shown()["Target"], place_colors(points, points), atol=1e-6)  # of the latest outline
    assert snapshot_file() == before


def test_refined_match_replaces_the_preliminary_preview(source, target, begin):
    job, refining = begin(np.arange(len(target.data.vertices)))
    write = end(job, refining)
    assert preview.preview_of(target).preliminary
    write()
    current = preview.preview_of(target)
    assert not current.preliminary
    assert current.passing
    preview.end_preliminary()
    assert preview.preview_of(target) is current


def test_cancel_or_error_restores_the_former_preview(source, target, begin):
    job, refining = begin(np.arange(len(target.data.vertices)))
    job.cancel()
    preview.end_preliminary()
    assert preview.current() is None
    end(*begin(np.arange(len(target.data.vertices))))()
    kept = preview.preview_of(target)
    job, refining = begin(np.arange(len(target.data.vertices))[::-1].copy())
    assert preview.preview_of(target).preliminary
    refining.error = zo.MeshError("No map was found.")
    with pytest.raises(zo.MeshError, match="No map was found"):
        end(job, refining)
    preview.end_preliminary()
    assert preview.preview_of(target) is kept


def test_the_end_of_an_operator_ends_a_preliminary_preview(monkeypatch):
    ended = []
    monkeypatch.setattr(preview, "end_preliminary", lambda: ended.append(True))
    monkeypatch.setattr("blender_addon.operators.base.modal_operator._show_progress", lambda *_: None)
    operator = SimpleNamespace(_job=Job(jobs.pause()), _timer=None)
    manager = SimpleNamespace(event_timer_remove=lambda timer: None)
    ModalOperator._end(operator, SimpleNamespace(window_manager=manager))
    assert ended


@pytest.mark.parametrize("kind", ["CONFIDENCE", None])
def test_other_previews_and_unseen_targets_are_unchanged(source, target, begin, kind):
    vertex = np.arange(len(target.data.vertices))
    if kind is not None:
        end(*begin(vertex))()
        bpy.ops.zoomout.preview(kind=kind)
    before = preview.current()
    begin(vertex, show_preview=kind is not None)
    assert preview.current() is before


def test_mirrored_half_has_no_colours(source, target, begin):
    count = len(target.data.vertices)
    begin(np.concatenate([np.arange(count), np.arange(count)]))
    assert len(shown()["Target"]) == count


def test_watching_runs_only_while_a_job_computes():
    gate, threads = threading.Event(), []

    async def work():
        with watching(lambda: threads.append(threading.current_thread())):
            await jobs.compute(gate.wait)
        await jobs.compute(gate.wait)

    job = Job(work())
    job.advance(0.05)
    assert set(threads) == {threading.current_thread()}
    gate.set()
    count = len(threads)
    while not job.advance(0.01):
        pass
    assert len(threads) <= count + 1
