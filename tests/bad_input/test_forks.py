# SPDX-License-Identifier: GPL-3.0-or-later
"""A process that forks while threads match has a child that can match."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import creatures
import pytest

import zoomout_core

PLACES = str(Path(zoomout_core.__file__).parents[1]), str(Path(creatures.__file__).parent)
# A thread holds what a match holds, while the main thread forks.
CODE = """
import os, threading
from creatures import creature
import zoomout_core as zo
from zoomout_core.matching.preparation import memory_cache
from zoomout_core.runtime import threads

surfaces = [creature(150, seed=seed).surface for seed in (0, 1)]
numbers = {{"initial": "proximity", "k_final": 20, "samples": 60}}
zo.set_threads(2)
zo.match(*surfaces, **numbers)
held = threading.Event()

def hold():
    with {held}:
        held.set()
        threading.Event().wait()

class Core:
    def __enter__(self):
        cores = threads._known_cores()._free
        cores.acquire(), cores.acquire()
    def __exit__(self, *_): pass

threading.Thread(target=hold, daemon=True).start()
held.wait()
child = os.fork()
if not child:
    zo.match(*surfaces, **numbers)
    os._exit(7 if threads.threads() == 2 else 1)
os._exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
HELD = {
    "everything": (
        "Core(), threads.one_blas_thread, threads.one_blas_thread._lock, memory_cache._shapes._lock, "
        "memory_cache._meshes._lock"
    ),
    "all cores": "Core()",
    "the lock of BLAS": "threads.one_blas_thread._lock",
    "BLAS at one thread": "threads.one_blas_thread",
    "the shapes": "memory_cache._shapes._lock",
    "the meshes": "memory_cache._meshes._lock",
}


@pytest.mark.slow(but=1)
@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system has no forks")
@pytest.mark.parametrize("name", HELD)
def test_the_child_can_match(name: str) -> None:
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(PLACES), "PYTHONWARNINGS": "ignore"}
    command = [sys.executable, "-c", CODE.format(held=HELD[name])]
    ran = subprocess.run(command, env=environment, timeout=120, capture_output=True, text=True)
    assert ran.returncode == 7, ran.stderr
