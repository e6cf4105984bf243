# SPDX-License-Identifier: GPL-3.0-or-later
"""Rename the shape keys of an asset to another convention."""

from __future__ import annotations

from dataclasses import replace

from zoomout_core.assets.asset import SHAPE_KEYS, Asset
from zoomout_core.transfer.keys.key_names import TranslatedKeys, describe, translate_offsets


def rename_keys(asset: Asset, convention: str) -> tuple[Asset, TranslatedKeys, list[str]]:
    """Rename the shape keys of an asset that has some; keys that are sums of others are added, see `key_names`.

    An animation of a glTF file has a weight for each key by its number, so no keys are added beside one.

    Args:
        asset: the asset.
        convention: the convention of the new names, such as "arkit".

    Returns:
        The asset, the names, and sentences about them.
    """
    offsets = asset.find(SHAPE_KEYS)
    if offsets is None:
        raise ValueError("The asset has no shape keys: read a file that has some.")
    compose = not _animates_keys(asset)
    renamed, keys = translate_offsets(offsets, convention, compose)
    notes: list[str] = [*describe(keys, compose)]
    if keys.composed and not compose:
        notes.append(
            f"Sums of shape keys ({', '.join(keys.composed)}) were not added, because the file has an animation of the "
            "shape keys: remove it to get them."
        )
    attributes = tuple(renamed if each is offsets else each for each in asset.attributes)
    return replace(asset, attributes=attributes), keys, notes


def _animates_keys(asset: Asset) -> bool:
    """Whether an animation of the asset's document weighs morph targets."""
    animations = () if asset.document is None else asset.document.gltf.animations
    return any(channel.target.path == "weights" for animation in animations for channel in animation.channels)
