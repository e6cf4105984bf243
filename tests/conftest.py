"""What the tests of several rooms have in common."""

from __future__ import annotations

from pathlib import Path

import pytest

BENCHMARK_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def benchmark_data() -> Path:
    """The folder of public research meshes, which the tests must also pass without."""
    if not BENCHMARK_DATA.is_dir():
        pytest.skip("the benchmark meshes are not here")
    return BENCHMARK_DATA
