# SPDX-License-Identifier: GPL-3.0-or-later
"""The overlay's colours as drawn by the GPU, in this version of Blender."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest


@pytest.fixture(scope="module")
def drawn():
    """(size, size, 4) pixels of each coat that was drawn."""
    script = Path(__file__).with_name("drawing_engine.py")
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True)
    if done.returncode < 0:
        pytest.skip("there is no GPU driver here, not even one in software")
    (line,) = (line for line in done.stdout.splitlines() if line.startswith("DRAWN "))
    return {name: np.array(pixels) for name, pixels in json.loads(line.removeprefix("DRAWN ")).items()}


def test_vertex_colours_are_interpolated(drawn):
    pixels = drawn["colors"]
    assert (pixels[..., 3] == 1).all()
    corners = pixels[[0, 0, -1, -1], [0, -1, -1, 0], :3]
    np.testing.assert_allclose(corners, [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], atol=0.1)
    np.testing.assert_allclose(pixels[8, 8, :3], [0.5, 0.25, 0.25], atol=0.3)


def test_uvs_are_drawn_as_a_checker(drawn):
    light = drawn["checker"][..., 1]
    assert ((light < 0.2) | (light > 0.5)).mean() > 0.9
    assert 0.3 < (light > 0.5).mean() < 0.7


def ink(drawn, name):
    """(9, 9) which dots of the single drawn square are inked, from its upper left corner."""
    light = drawn[name][::-1, :, 1]
    centres = ((np.arange(9) + 0.5) * len(light) / 9).astype(int)
    found = light[np.ix_(centres, centres)] > 0.4
    return found != found[0, 0]


def test_large_checker_square_shows_its_column_and_row(drawn):
    dots = ["".join(" #"[int(dot)] for dot in row) for row in ink(drawn, "letters")]
    assert dots == [
        "         ",
        "         ",
        "  #  ### ",
        " # # # # ",
        " ### # # ",
        " # # # # ",
        " # # ### ",
        "         ",
        "         ",
    ]


def test_an_arrow_points_to_the_top_and_its_barb_is_on_the_right(drawn):
    dots = ink(drawn, "arrow")
    assert dots[1:8, 4].all()
    assert (dots[2, 5], dots[3, 6], dots[2, 3], dots[3, 2]) == (True, True, False, False)
    assert dots.sum() == 9
