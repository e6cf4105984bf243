# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs run one after the other, and their progress adds up."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import zoomout_core as zo
from zoomout_core.batch import Job, figures_of, plan, run_jobs
from zoomout_core.command_options import progress_bar
from zoomout_core.matching.report.verdict import check_verdict, judge
from zoomout_core.mesh.formats.folders import meshes_of
from zoomout_core.runtime.progress import advance, stage

JOBS = [Job(Path(f"{number}.ply"), Path(f"{number}.glb")) for number in range(3)]


def work(job: Job, report: dict[str, Any]) -> list[str]:
    """Fail for the second job, and refuse the third."""
    with stage("Working"):
        advance(0.5)
        report["stem"] = job.target.stem
        if job is JOBS[1]:
            raise zo.MeshError("It is not a mesh.")
        check_verdict(judge(0.1 if job is JOBS[2] else 0.99), force=False)
    return [f"Did {job.target.stem}."]


def test_failed_job_keeps_its_figures_and_the_others_run() -> None:
    figures = figures_of("source.glb", run_jobs(JOBS, work), {"detail": "fast"})
    assert figures["options"] == {"detail": "fast"}
    assert {"version", "time", "source"} < figures.keys()
    written, failed, refused = json.loads(json.dumps(figures))["targets"]
    assert written == {"target": "0.ply", "status": "written", "output": "0.glb", "stem": "0"}
    assert failed == {"target": "1.ply", "status": "failed", "error": "It is not a mesh.", "stem": "1"}
    assert refused.pop("error").startswith("The match is probably wrong")
    assert refused == {"target": "2.ply", "status": "refused", "stem": "2"}


def test_duplicate_target_is_processed_once(tmp_path: Path) -> None:
    for name in ("source.ply", "a.ply", "b.ply"):
        (tmp_path / name).touch()
    named = [str(tmp_path / name) for name in ("a.ply", "b.ply", "a.ply")]
    jobs = plan(str(tmp_path / "source.ply"), named, str(tmp_path / "out"), ".glb", (".ply",), lambda _: None)
    assert [job.output.name for job in jobs] == ["a.glb", "b.glb"]
    (tmp_path / "only").mkdir()
    (tmp_path / "only" / "source.ply").touch()
    with pytest.raises(zo.MeshError, match="contains no meshes besides the source: check the path"):
        meshes_of(tmp_path / "only", (".ply",), tmp_path / "only" / "source.ply")


def test_progress_names_the_current_job() -> None:
    told: list[zo.Progress] = []
    with zo.progress(told.append):
        run_jobs(JOBS, work)
    halfway = [one for one in told if one.stage and one.fraction * 6 % 2 > 0.5]
    assert [one.stage for one in halfway] == ["1/3 Working", "2/3 Working", "3/3 Working"]
    assert [one.fraction for one in halfway] == pytest.approx([1 / 6, 3 / 6, 5 / 6])
    told.clear()
    with zo.progress(told.append):
        run_jobs(JOBS[:1], work)
    assert {one.stage for one in told} <= {"", "Working"}


def test_cancelling_a_batch_skips_the_remaining_jobs() -> None:
    begun = []

    def listen(latest: zo.Progress) -> None:
        if latest.stage == "2/3 Working":
            raise zo.Cancelled

    def noted(job: Job, report: dict[str, Any]) -> list[str]:
        begun.append(job)
        return work(job, report)

    with pytest.raises(zo.Cancelled), zo.progress(listen):
        run_jobs(JOBS, noted)
    assert begun == JOBS[:2]


def test_progress_bar_shows_stage_and_completion(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar(), stage("Working"):
        advance(0.25)
    said = capsys.readouterr().err
    assert "Working" in said
    assert "100%" in said
