"""pymeshlab and bpy live in one process only if bpy comes first, so here it comes first wherever it is installed.

pytest runs this before it imports any test of this folder, whatever other folders it was given, and in which
order.
"""

import os
import pickle
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from hashlib import sha256
from typing import Any

import pytest

# As in tests/blender: wheels of extensions that this machine's user has installed would shadow the packages here.
os.environ.setdefault("BLENDER_USER_EXTENSIONS", tempfile.mkdtemp())
# Nor do tests keep anything in the cache of this machine's user.
os.environ["ZOOMOUT_CACHE"] = "off"

with suppress(ImportError):
    import bpy  # noqa: F401

import zoomout_core as zo
from zoomout_core import MatchResult, Surface
from zoomout_core.runtime.stepping import Progress, Steps

_MATCHES: dict[bytes, tuple[list[Progress], MatchResult]] = {}


@pytest.fixture(scope="module")
def remembered_matches() -> Iterator[None]:
    """A match that is asked for again is the one that came of it before, with the same progress.

    For modules that are about what becomes of matches: these are deterministic, and take most of the time.
    """

    def match_steps(source: Surface, target: Surface, **options: Any) -> Steps[MatchResult]:
        shapes = [(shape.vertices, shape.corner_vertex, shape.face_start) for shape in (source, target)]
        key = sha256(pickle.dumps((shapes, sorted(options.items())))).digest()
        if key in _MATCHES:
            told, result = _MATCHES[key]
            yield from told
            return result
        told = []
        steps = match(source, target, **options)
        while True:
            try:
                told.append(next(steps))
            except StopIteration as finished:
                _MATCHES[key] = told, finished.value
                return finished.value
            yield told[-1]

    match = zo.match_steps
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(zo, "match_steps", match_steps)
        yield
