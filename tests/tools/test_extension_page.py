# SPDX-License-Identifier: GPL-3.0-or-later
"""The animation of the extension's page: its timing and poses, without rendering, which takes minutes."""

import bpy
import pytest
from extension_page_poses import STEP, between, mirror
from extension_page_scene import FPS
from extension_page_video import WIPE, Shot, edit


@pytest.fixture
def files(tmp_path):
    image = bpy.data.images.new("Frame", 16, 9)
    paths = [tmp_path / f"{number}.png" for number in range(5)]
    for path in paths:
        image.save(filepath=str(path))
    return paths


def test_shots_keep_their_durations_and_wipe_into_the_next(files):
    edit(
        [
            Shot(files[:1], 2, "One"),
            Shot(files[1:2], 3, "Two"),
            Shot(files[2:], 3 / FPS, "Moving"),
            Shot(files[-1:], 1, "End"),
        ]
    )
    scene = bpy.context.scene
    assert (scene.frame_start, scene.frame_end, scene.render.fps) == (1, 6 * FPS + 3, FPS)
    strips = {strip.name: strip for strip in scene.sequence_editor.strips}
    captions = [strips[f"Caption {number}"] for number in range(4)]
    assert [caption.text for caption in captions] == ["One", "Two", "Moving", "End"]
    assert [caption.frame_final_start for caption in captions] == [1, 1 + 2 * FPS, 1 + 5 * FPS, 4 + 5 * FPS]
    assert {name for name in strips if name.startswith("Wipe")} == {
        "Wipe 1",
        "Wipe 2",
    }  # the last goes on with a picture
    assert strips["Wipe 1"].frame_final_duration == round(WIPE * FPS)
    assert strips["Shot 0"].frame_final_end == strips["Wipe 1"].frame_final_end


def test_mirrored_pose_swaps_sides_and_rotation_signs():
    assert mirror({"thigh.L": (-38, 1, 2), "spine": (4, 0, 8)}) == {"thigh.R": (-38, -1, -2), "spine": (4, 0, -8)}
    assert mirror(mirror(STEP)) == STEP


def test_interpolated_pose_starts_and_ends_at_given_poses():
    assert between({}, STEP, 0)["thigh.L"] == (0, 0, 0)
    assert between({}, STEP, 0.5)["thigh.L"] == (-19, 0, 0)
    assert between({}, STEP, 1)["thigh.L"] == STEP["thigh.L"]
