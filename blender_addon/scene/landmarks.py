# SPDX-License-Identifier: GPL-3.0-or-later
"""Landmarks: numbered places on objects; places with the same number correspond.

They are stored on the scene, each with a place on every object that it was set on: one source may have many targets.
A place may be a proposal from a match. It is shown, but does not count until it is moved or confirmed: as evidence, it
would only prove the match that it came from.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from bpy.types import Context, Depsgraph, Object, Scene
from mathutils import Vector

import zoomout_core as zo
from zoomout_core.arrays import Floats
from zoomout_core.matching.pair import MAX_LANDMARK_DISTANCE
from zoomout_core.messages import enumeration, message, plural

from ..mesh_data import SurfacePoint, evaluated_mesh, extent, nearest_surface_point, positions_in_world
from ..mesh_data.arrays import hash_of
from ..properties.landmarks import ZOOMOUT_PG_landmark, ZOOMOUT_PG_place
from .pair import check_context, name_of
from .selection import participants

# Starts of a match that may use landmarks.
OF_LANDMARKS = ("auto", "landmarks")


@dataclass(frozen=True, eq=False)
class LandmarkPairs:
    """The landmarks that two objects have in common, for `zoomout_core.match`.

    Attributes:
        numbers: numbers of the landmarks.
        source: (m, 3) points on the source, in world space.
        target: (m, 3) points on the target, in world space.
        notes: sentences about landmarks that were left out.
    """

    numbers: tuple[int, ...]
    source: Floats
    target: Floats
    notes: tuple[str, ...]


NO_LANDMARKS = LandmarkPairs((), np.empty((0, 3)), np.empty((0, 3)), ())


def landmark_pairs(context: Context, source: Object, target: Object) -> LandmarkPairs:
    """The landmarks that two objects have in common, at their present places.

    Raises:
        MeshError: an object is disabled, or was removed from the file.
        TypeError: the context is not Blender's, or one of the two is not an object.
    """
    check_context(context)
    for obj in (source, target):
        name_of(obj)
    on_both, on_one, gone = [], [], []
    depsgraph = context.evaluated_depsgraph_get()
    places = {obj: world_positions(obj, surface_points_on(context.scene, obj), depsgraph) for obj in (source, target)}
    for number in sorted({*places[source], *places[target]}):
        missing = [obj for obj in (source, target) if number not in places[obj]]
        lost = [obj.name for obj in (source, target) if number in places[obj] and places[obj][number] is None]
        on_one += [_how_missing(context.scene, missing[0], number)] if missing else []
        gone += [message("{number} (on '{name}')", number=number, name=lost[0])] if lost and not missing else []
        if not missing and not lost:
            on_both.append(number)
    notes = []
    if on_one:
        notes.append(
            message(
                "Landmarks that are on only one of the two objects were not used: {landmarks}.",
                landmarks=enumeration(on_one),
            )
        )
    if gone:
        notes.append(
            message(
                "Landmarks on deleted geometry were not used: {landmarks}; place them again, or remove them.",
                landmarks=enumeration(gone),
            )
        )
    of_source, of_target = (
        np.array([places[obj][number] for number in on_both]).reshape(-1, 3) for obj in (source, target)
    )
    return LandmarkPairs(tuple(on_both), of_source, of_target, tuple(notes))


def _how_missing(scene: Scene, obj: Object, number: int) -> str:
    """A landmark that an object lacks, or has only as a proposal, in words for a note."""
    proposed = number in surface_points_on(scene, obj, proposed=True)
    how = "{number} (only proposed on '{name}')" if proposed else "{number} (missing on '{name}')"
    return message(how, number=number, name=obj.name)


def landmarks_fingerprint(scene: Scene, source: Object, target: Object) -> str:
    """A hash of the common landmarks of two objects that does not depend on poses."""
    of_source, of_target = surface_points_on(scene, source), surface_points_on(scene, target)
    common = [(number, of_source[number], of_target[number]) for number in sorted(of_source.keys() & of_target.keys())]
    return hash_of(repr(common))


def landmarks_in_words(number: int) -> str:
    """A number of landmarks, in words."""
    return plural(number, "1 landmark", "{count} landmarks")


def obstacle(context: Context) -> str:
    """The reason why the landmarks of the source and the targets cannot be changed now, or an empty string."""
    try:
        participants(context)
    except zo.MeshError as error:
        return str(error)
    return ""


def surface_points_on(scene: Scene, obj: Object, proposed: bool = False) -> dict[int, SurfacePoint]:
    """The surface points of all landmarks on an object, by number; with proposals if `proposed`."""
    settings = getattr(scene, "zoomout", None)  # absent if the extension is not registered
    landmarks = settings.landmarks if settings else ()
    found = ((landmark.number, _stored_place(landmark, obj)) for landmark in landmarks)
    return {
        number: stored.place() for number, stored in found if stored is not None and (proposed or not stored.proposed)
    }


def world_positions(obj: Object, places: dict[int, SurfacePoint], depsgraph: Depsgraph) -> dict[int, Floats | None]:
    """Present positions of places on an object, in world space; None for places whose surface was removed.

    Raises:
        MeshError: the object is disabled.
    """
    if not places:
        return {}
    found: dict[int, Floats | None] = {}
    with evaluated_mesh(obj, depsgraph) as (_, mesh):
        most = MAX_LANDMARK_DISTANCE * extent(mesh)
        here = {number: place.on(mesh) for number, place in places.items()}
    for number, position in here.items():
        if position is None:
            again = nearest_surface_point(obj, Vector(places[number].position), most, depsgraph)
            position = None if again is None else Vector(again.position)
        found[number] = None if position is None else positions_in_world(obj, np.array(position, np.float64))
    return found


def set_landmark(
    scene: Scene, obj: Object, place: SurfacePoint, number: int, name: str = "", proposed: bool = False
) -> None:
    """Set the place of a landmark on an object; it replaces an earlier one."""
    forget_removed_objects(scene)
    landmark = _landmark(scene, number)
    if name:
        landmark.name = name
    stored = _stored_place(landmark, obj) or landmark.places.add()
    stored.object = obj
    stored.proposed = proposed
    stored.take(place)


def confirm_landmarks(scene: Scene, objects: Sequence[Object], numbers: Collection[int] | None = None) -> int:
    """Confirm the proposed places of some or all landmarks on some objects; returns their number."""
    found = [
        stored
        for landmark in scene.zoomout.landmarks
        for stored in landmark.places
        if stored.proposed and stored.object in objects and (numbers is None or landmark.number in numbers)
    ]
    for stored in found:
        stored.proposed = False
    return len(found)


def next_number(scene: Scene, obj: Object, others: Iterable[Object]) -> int:
    """The number of the next landmark on an object.

    It is the lowest number that another object has and this one lacks, or has as a proposal; otherwise the next one.
    """
    own = set(surface_points_on(scene, obj))
    theirs = set().union(*(surface_points_on(scene, other) for other in others if other != obj))
    return min(theirs - own, default=max(own | theirs, default=0) + 1)


def remove_landmark(scene: Scene, number: int, objects: Sequence[Object]) -> None:
    """Remove a landmark from some objects, and from the list if no other object has it."""
    landmarks = scene.zoomout.landmarks
    for index in [i for i, landmark in enumerate(landmarks) if landmark.number == number]:
        places = landmarks[index].places
        for other in reversed([i for i, stored in enumerate(places) if stored.object in objects]):
            places.remove(other)
    forget_removed_objects(scene)


def remove_landmarks_on(scene: Scene, objects: Sequence[Object]) -> int:
    """Remove all landmarks from some objects; returns the number of landmarks."""
    numbers = sorted(set().union(*(surface_points_on(scene, obj, proposed=True) for obj in objects)))
    for number in numbers:
        remove_landmark(scene, number, objects)
    return len(numbers)


def forget_removed_objects(scene: Scene) -> None:
    """Drop places on objects that are no longer in the scene, and landmarks without confirmed places."""
    landmarks = scene.zoomout.landmarks
    for landmark in landmarks:
        for i in reversed([i for i, stored in enumerate(landmark.places) if not _in_scene(scene, stored)]):
            landmark.places.remove(i)
    for index in reversed(
        [i for i, landmark in enumerate(landmarks) if all(stored.proposed for stored in landmark.places)]
    ):
        landmarks.remove(index)
    active = max(0, min(scene.zoomout.active_landmark, len(landmarks) - 1))
    if active != scene.zoomout.active_landmark:  # writing it would tag the scene as changed
        scene.zoomout.active_landmark = active


def _landmark(scene: Scene, number: int) -> ZOOMOUT_PG_landmark:
    """The landmark with a number, which becomes active; it is added if missing."""
    landmarks = scene.zoomout.landmarks
    index = sum(landmark.number < number for landmark in landmarks)
    if index == len(landmarks) or landmarks[index].number != number:
        landmarks.add()
        landmarks.move(len(landmarks) - 1, index)
        landmarks[index].number, landmarks[index].name = number, f"Landmark {number}"
    scene.zoomout.active_landmark = index
    return landmarks[index]


def _stored_place(landmark: ZOOMOUT_PG_landmark, obj: Object) -> ZOOMOUT_PG_place | None:
    return next((stored for stored in landmark.places if stored.object == obj), None)


def _in_scene(scene: Scene, stored: ZOOMOUT_PG_place) -> bool:
    return stored.object is not None and scene.objects.get(stored.object.name) == stored.object
