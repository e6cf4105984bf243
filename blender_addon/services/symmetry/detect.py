# SPDX-License-Identifier: GPL-3.0-or-later
"""Detect the symmetries of a mesh, store them on it, and choose among them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from bpy.types import Context, Object

import zoomout_core as zo
from zoomout_core.messages import message, plural
from zoomout_core.runtime.progress import stage

from ...jobs import compute, pause, run
from ...properties.symmetry import AXES
from ...scene.pair import name_of
from ...storage import stored_symmetry
from ..matching import previews
from ..targets import WRITING
from .mesh_access import writable_mesh, writing

# Maximum number of stored candidates: objects such as wheels have many symmetries.
MAX_COUNT = 6


def detect_symmetry(context: Context, obj: Object, left: str = "X") -> tuple[zo.Symmetry, ...]:
    """Find the symmetries of an object's mesh, and store them on it.

    Args:
        context: Blender's; the object is in its scene.
        obj: a mesh object, in any pose.
        left: the object's axis that points to the character's left, a key of `AXES`.

    Returns:
        The symmetries, the most likely first.

    Raises:
        MeshError: the mesh cannot be used, or no symmetry was found; nothing was written.
        ValueError: there is no such axis.
    """
    return run(detect_symmetry_async(context, name_of(obj), left))


async def detect_symmetry_async(
    context: Context, name: str, left: str = "X", show_preview: bool = False
) -> tuple[zo.Symmetry, ...]:
    """`detect_symmetry` as a coroutine, which keeps no Blender data across an `await`.

    With `show_preview`, pairs are shown if there is no preview.
    """
    if left not in AXES:
        raise ValueError(f"left is {left!r}: choose one of {', '.join(AXES)}.")
    surface = stored_symmetry.rest_surface(writable_mesh(context, name))
    found = await compute(partial(zo.detect_symmetry, surface, max_count=MAX_COUNT, left=AXES[left]))
    if not found:
        raise zo.MeshError("No symmetry of '{name}' was found: it may have none.", name=name)
    with stage(WRITING, 1):
        await pause()
    with writing(context, name, surface) as obj:
        stored_symmetry.write(obj, found, left)
    previews.follow_symmetry(context, obj, show_preview)
    return found


def choose_symmetry(context: Context, obj: Object, number: int) -> str:
    """Use another symmetry stored on an object's mesh; returns a sentence for the user.

    Raises:
        MeshError: there is no symmetry of that number.
    """
    stored = stored_symmetry.description(obj.data)
    candidates = stored["candidates"] if stored else []
    if number >= len(candidates):
        raise zo.MeshError(
            "'{name}' has only {symmetries}: choose a lower number.", name=obj.name, symmetries=_count(len(candidates))
        )
    stored_symmetry.choose(obj.data, number)
    previews.follow_symmetry(context, obj)
    return message("'{name}': {symmetry}", name=obj.name, symmetry=stored_symmetry.summary(candidates[number]))


def swap_sides(context: Context, obj: Object) -> str:
    """Swap left and right of the chosen symmetry of an object's mesh; returns a sentence for the user.

    Raises:
        MeshError: no symmetry is stored, or the chosen one has no sides.
    """
    stored_symmetry.swap_sides(obj)
    previews.follow_symmetry(context, obj)
    return message("Left and right of '{name}' were swapped", name=obj.name)


def found_summary(name: str, found: Sequence[zo.Symmetry]) -> str:
    """The symmetries found on an object, in a sentence."""
    return message(
        "Found {symmetries} of '{name}'; the first: {first}",
        symmetries=_count(len(found)),
        name=name,
        first=stored_symmetry.summary(stored_symmetry.describe(found[0])),
    )


def _count(number: int) -> str:
    return plural(number, "one symmetry", "{count} symmetries")
