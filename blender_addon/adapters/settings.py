# SPDX-License-Identifier: GPL-3.0-or-later
"""How data is transferred."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Literal

from bpy.types import Object

import zoomout_core as zo
from zoomout_core.symmetry.flip_name import counterpart_of
from zoomout_core.transfer import Blend, Mode

from .. import mesh_data

# Below this confidence values are filled in. Mapped ones are as often nearer to the truth as filled ones there, and
# above it more often; but what the source has no counterpart for, as a tail that only the target has, lies below.
FILL_BELOW = 0.05


@dataclass(frozen=True)
class Settings:
    """How data is transferred, of whatever kind it is.

    Attributes:
        fill_below: numbers, colours and weights of less confidence than this are filled in from around them.
        without_partner: what becomes of vertices that nothing on the source corresponds to. "fill": they take what is
            around them. "keep": they stay as they are.
        mode: how they are blended with what the target has, see `Blend`.
        factor: how much of them is taken.
        mask_group: the vertex group of the target that limits where; empty for everywhere.
        limit: largest number of weights of deforming groups per vertex; 0 for that of the source.
        flip_names: whether vertex groups change sides, from "Arm.L" to "Arm.R", for a match that does.
        group_names: new names of vertex groups by their names on the source.
        turning: names of vectors, quaternions and matrices, in the mesh's own space, that turn with the surface.
    """

    fill_below: float = FILL_BELOW
    without_partner: Literal["fill", "keep"] = "fill"
    mode: Mode = "mix"
    factor: float = 1.0
    mask_group: str = ""
    limit: int = 0
    flip_names: bool = False
    group_names: Mapping[str, str] = field(default_factory=dict)
    turning: Collection[str] = ()

    def new_name(self, group: str, names: Collection[str]) -> str:
        """What a vertex group of the source, which has groups and bones of some names, is called on the target."""
        if group in self.group_names:
            return self.group_names[group]
        return counterpart_of(group, names) if self.flip_names else group

    def blend(self, target: Object) -> Blend:
        """How values are blended with those of a target.

        Raises:
            MeshError: it has no such mask.
        """
        if not self.mask_group:
            return Blend(self.mode, self.factor)
        return Blend(self.mode, self.factor, mesh_data.read_mask(target, self.mask_group))


DEFAULT = Settings()


@dataclass(frozen=True)
class Binding:
    """How a target is bound to its source's armature.

    Attributes:
        shape: "rest_pose": the target stands in a pose, and is taken to the rest pose. "keep_shape": it stands in the
            rest pose already. "automatic": whichever is the case.
        replace: whether it is taken off the armatures that it is bound to; else such a target is refused.
    """

    shape: Literal["automatic", "rest_pose", "keep_shape"] = "automatic"
    replace: bool = False


def parse_names(text: str) -> tuple[str, ...]:
    """Names with commas between them."""
    return tuple(filter(None, (name.strip() for name in text.split(","))))


def parse_group_names(text: str) -> dict[str, str]:
    """New names of vertex groups by the old ones, from `old = new` pairs with commas between them.

    Raises:
        MeshError: the text is not of that form.
    """
    names: dict[str, str] = {}
    for pair in parse_names(text):
        old, equals, new = (part.strip() for part in pair.partition("="))
        if not (old and equals and new):
            raise zo.MeshError(
                "Write new group names as 'old = new, old = new': '{pair}' is not such a pair.", pair=pair
            )
        names[old] = new
    return names
