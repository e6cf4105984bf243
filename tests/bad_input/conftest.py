# SPDX-License-Identifier: GPL-3.0-or-later
"""All entry points are tested, so both hosts are needed: bpy must be imported before pymeshlab."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

# As in tests/blender: wheels of extensions that this machine's user has installed would shadow the packages here.
os.environ.setdefault("BLENDER_USER_EXTENSIONS", tempfile.mkdtemp())
os.environ["ZOOMOUT_CACHE"] = "off"

with suppress(ImportError):
    import bpy  # noqa: F401

import trimesh
from creatures import creature
from interfaces import Limit


@pytest.fixture(scope="module", autouse=True)
def _each_match_quick(quick_search: None) -> None:
    """Matches are computed by the core, and tested there."""


@pytest.fixture
def meshes(tmp_path: Path) -> tuple[Path, Path]:
    """Two small meshes in their own folder."""
    paths = tmp_path / "source.ply", tmp_path / "target.ply"
    for seed, path in enumerate(paths):
        surface = creature(400, seed=seed).surface
        trimesh.Trimesh(surface.vertices, surface.triangles, process=False).export(path)
    return paths


@pytest.fixture
def size_limit() -> Limit:
    """A context manager that limits the size of files in bytes, like a full disk."""
    resource = pytest.importorskip("resource")

    @contextmanager
    def limited(max_bytes: int) -> Iterator[None]:
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (max_bytes, hard))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))

    return limited
