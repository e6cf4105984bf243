# SPDX-License-Identifier: GPL-3.0-or-later
"""The joints of an asset as bones with names, to compare them with those of another asset."""

from __future__ import annotations

import numpy as np

from zoomout_core.arrays import Floats, Integers
from zoomout_core.assets.asset import Asset
from zoomout_core.assets.gltf.avatars import read_avatar
from zoomout_core.transfer.rigging.bone_pairs import Skeleton


def skeleton_of(asset: Asset, joints: Integers, heads: Floats) -> Skeleton:
    """Bones for some joints of an asset, which has a skin.

    Args:
        asset: the asset, with b joints.
        joints: (j,) the numbers of the chosen joints. A parent that is not among them is left out.
        heads: (b, 3) positions of all joints.
    """
    assert asset.skin is not None
    number = {joint: new for new, joint in enumerate(joints.tolist())}
    parents = np.array([number.get(above, -1) for above in asset.skin.parents[joints].tolist()], dtype=np.int64)
    avatar = read_avatar(asset.document)
    names = [asset.skin.names[joint] for joint in joints]
    return Skeleton(names, parents, heads[joints], None if avatar is None else avatar.humanoid)
