"""The overlay's colours as the GPU draws them, in this version of Blender."""

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


def test_colours_of_vertices_are_drawn_between_them(drawn):
    pixels = drawn["colors"]
    assert (pixels[..., 3] == 1).all()
    corners = pixels[[0, 0, -1, -1], [0, -1, -1, 0], :3]
    np.testing.assert_allclose(corners, [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]], atol=0.1)
    np.testing.assert_allclose(pixels[8, 8, :3], [0.5, 0.25, 0.25], atol=0.3)


def test_uvs_are_drawn_as_squares_of_two_lights(drawn):
    light = drawn["checker"][..., 1]
    assert ((light < 0.2) | (light > 0.5)).mean() > 0.9
    assert 0.3 < (light > 0.5).mean() < 0.7
