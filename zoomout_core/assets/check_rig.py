# SPDX-License-Identifier: GPL-3.0-or-later
"""Play the animations of a source on a target with its moved rig, and compare the two."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from zoomout_core.arrays import Floats
from zoomout_core.assets.asset import Asset, Skin
from zoomout_core.assets.gltf.move_skin import UP
from zoomout_core.assets.gltf.play import length_of, play
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.mesh.formats.gltf_document import Document
from zoomout_core.transfer.rigging.motion import MotionCheck, PlayedMotion, SkinnedBody, check_motions

# Frames of an animation per second, and the largest number of them.
RATE, MAX_FRAMES = 15.0, 60


def check_rig(source: Asset, target: Asset, surface_map: SurfaceMap) -> tuple[MotionCheck, ...]:
    """Compare how a target with the moved rig of a source plays each animation; none for a source without animations.

    Args:
        source: the asset with the rig.
        target: what `transfer_asset` made of it with `move_rig`.
        surface_map: the place of each target vertex on the source.
    """
    if source.skin is None or target.skin is None or source.document is None or target.document is None:
        return ()
    body, place = _stand_up(source.skin)
    own_body, own_place = _stand_up(target.skin)
    motions = _motions((source.document, target.document), (source.skin, target.skin), (place, own_place))
    return check_motions(body, own_body, surface_map, source.skin.parents, UP, list(motions))


def _stand_up(skin: Skin) -> tuple[SkinnedBody, Floats]:
    """A skin at rest as the root places it in the scene, and (4, 4) the transform that does so."""
    place = skin.transforms[int(np.argmin(skin.parents))]
    joints = np.linalg.inv(skin.inverse_bind)[:, :3, 3]
    rest, joints = (points @ place[:3, :3].T + place[:3, 3] for points in (skin.rest, joints))
    return SkinnedBody(rest, skin.weights, joints), place


def _motions(documents: Sequence[Document], skins: Sequence[Skin], places: Sequence[Floats]) -> Iterator[PlayedMotion]:
    """The animations of two documents."""
    for animations in zip(*(document.gltf.animations for document in documents), strict=True):
        length = length_of(documents[0], animations[0])
        if length <= 0:
            continue
        times = np.linspace(0, length, min(int(RATE * length) + 2, MAX_FRAMES))
        of_source, of_target = (
            (play(document, animation, times)[:, skin.nodes] @ skin.inverse_bind @ np.linalg.inv(place))[:, :, :3]
            for document, animation, skin, place in zip(documents, animations, skins, places, strict=True)
        )
        yield PlayedMotion(animations[0].name or "Animation", float(times[1]), of_source, of_target)
