# SPDX-License-Identifier: GPL-3.0-or-later
"""Renaming morph targets keeps animations, which refer to them by number."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from skinned_tubes import write_tube

from zoomout_core.assets.asset import SHAPE_KEYS, Asset
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.assets.key_names import rename_keys

SPLIT = ("browInnerUp_L", "browInnerUp_R", "jawOpen")


def with_keys(asset: Asset) -> Asset:
    """An asset with the keys of a face, each a copy of its first key."""
    offsets = asset.find(SHAPE_KEYS)
    assert offsets is not None
    values = np.repeat(offsets.values[:, :1], len(SPLIT), axis=1)
    attributes = [each for each in asset.attributes if each is not offsets]
    return replace(asset, attributes=(*attributes, replace(offsets, values=values, labels=SPLIT)))


def test_no_key_is_added_to_an_animated_asset(tmp_path: Path) -> None:
    write_tube(tmp_path / "tube.glb")
    animated = with_keys(read_asset(tmp_path / "tube.glb"))
    renamed, keys, notes = rename_keys(animated, "arkit")
    offsets = renamed.find(SHAPE_KEYS)
    assert offsets is not None
    assert offsets.labels == SPLIT
    assert keys.composed == {"browInnerUp": SPLIT[:2]}
    assert "because the file has an animation" in notes[-1]

    still = replace(animated, document=None, skin=None)
    renamed, keys, notes = rename_keys(still, "arkit")
    write_asset(renamed, tmp_path / "out.glb")
    again = read_asset(tmp_path / "out.glb").find(SHAPE_KEYS)
    assert again is not None
    assert again.labels == (*SPLIT, "browInnerUp")
    assert not [note for note in notes if "animation" in note]


def test_an_asset_without_shape_keys_is_refused(tmp_path: Path) -> None:
    write_tube(tmp_path / "tube.glb")
    asset = read_asset(tmp_path / "tube.glb")
    with pytest.raises(ValueError, match="has no shape keys: read a file"):
        rename_keys(replace(asset, attributes=()), "arkit")
