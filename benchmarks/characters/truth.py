# SPDX-License-Identifier: GPL-3.0-or-later
"""True correspondence of a pair of characters: by the weights that should arrive, or by places on a common body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.characters.game import Body, Character
from benchmarks.characters.skeleton import Limbs, limbs_of
from zoomout_core.arrays import Floats, Integers


@dataclass(frozen=True, eq=False)
class Bones:
    """The truth by weights.

    Attributes:
        names: (b,) the bones of both sides.
        limb: (b,) the index of each bone's limb.
        limb_names: of the limbs.
        side: (b,) 1 on the left, -1 on the right, 0 in the middle.
        source: (n_s, b) weights; rows sum to one.
        target: (n_t, b) weights, as they should arrive.
    """

    names: tuple[str, ...]
    limb: Integers
    limb_names: tuple[str, ...]
    side: Integers
    source: Floats
    target: Floats


@dataclass(frozen=True, eq=False)
class Rest:
    """The exact truth: places on a common undressed body.

    Attributes:
        source: (n_s, 3) the place of each source vertex.
        target: (n_t, 3) the place of each target vertex.
        unit: the length of a centimetre.
        source_part: (n_s,) the part of the outfit, such as a shoe, that each source vertex belongs to.
        target_part: (n_t,) the same of the target's.
    """

    source: Floats
    target: Floats
    unit: float
    source_part: Integers
    target_part: Integers


def bones_of(source: Character, target: Character, body: Body) -> Bones:
    """The weights over the bones of both, by the limbs of the target's skeleton."""
    of_source, of_target = limbs_of(source.skeleton), limbs_of(target.skeleton)
    ours = dict(zip(source.skeleton.names, _translate(source, of_source, target, of_target), strict=True))
    theirs = dict(zip(target.skeleton.names, of_target.limb, strict=True))
    sides = dict(zip(source.skeleton.names, of_source.side.tolist(), strict=True))
    sides |= dict(zip(target.skeleton.names, of_target.side.tolist(), strict=True))
    columns = {name: (_column(source, source.rest, name), _column(target, body, name)) for name in (ours | theirs)}
    names = tuple(name for name, (a, b) in columns.items() if a.any() or b.any())
    limb_names, limb = np.unique([(ours | theirs)[name] for name in names], return_inverse=True)
    return Bones(
        names,
        limb,
        tuple(limb_names.tolist()),
        np.array([sides[name] for name in names]),
        np.stack([columns[name][0] for name in names], axis=1),
        np.stack([columns[name][1] for name in names], axis=1),
    )


def _translate(source: Character, of_source: Limbs, target: Character, of_target: Limbs) -> list[str]:
    """The limbs of the source's bones, renamed after the target's limb with which they share the most bones."""
    theirs = dict(zip(target.skeleton.names, of_target.limb, strict=True))
    called: dict[str, str] = {}
    for limb in dict.fromkeys(of_source.limb):
        members = [name for name, own in zip(source.skeleton.names, of_source.limb, strict=True) if own == limb]
        shared = [theirs[name] for name in members if name in theirs]
        called[limb] = max(dict.fromkeys(shared), key=shared.count) if shared else limb
    return [called[limb] for limb in of_source.limb]


def _column(character: Character, body: Body, bone: str) -> Floats:
    """(n,) the weights of a bone; zero if the character lacks it."""
    names = character.skeleton.names
    return body.weights[:, names.index(bone)] if bone in names else np.zeros(len(body.vertices), np.float32)
