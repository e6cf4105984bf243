# SPDX-License-Identifier: GPL-3.0-or-later
"""How data is transferred."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Literal

from bpy.types import Object

import zoomout_core as zo
from zoomout_core.symmetry.flip_name import partner_of
from zoomout_core.transfer.blend_settings import Blend, Mode

from .. import mesh_data

# Below this confidence, values are filled in. There, mapped values are nearer to the truth as often as filled ones, and
# above it more often. Parts without a partner on the source, such as a tail that only the target has, are below.
FILL_BELOW = 0.05


@dataclass(frozen=True)
class Settings:
    """How data of any kind is transferred.

    Attributes:
        fill_below: numbers, colours and weights of less confidence than this are filled in from around them.
        without_partner: how vertices without a partner on the source are treated. "fill": they are filled in from
            around them. "keep": they keep their data.
        mode: how values are blended with the target's own, see `Blend`.
        factor: weight of the transferred values.
        mask_group: the vertex group of the target that limits the transfer; empty for everywhere.
        limit: maximum number of weights of deforming groups per vertex; 0 for the source's maximum.
        flip_names: whether vertex groups swap sides, such as "Arm.L" to "Arm.R", for a match that does.
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
        """A source group's name on the target; `names` are those of all groups and bones of the source."""
        if group in self.group_names:
            return self.group_names[group]
        return partner_of(group, names) if self.flip_names else group

    def blend(self, target: Object) -> Blend:
        """How to blend values with a target's own.

        Raises:
            MeshError: the target lacks the mask group.
        """
        if not self.mask_group:
            return Blend(self.mode, self.factor)
        return Blend(self.mode, self.factor, mesh_data.read_mask(target, self.mask_group))


DEFAULT = Settings()


@dataclass(frozen=True)
class Binding:
    """How a target is bound to its source's armature.

    Attributes:
        shape: "rest_pose": the target is posed, and is moved to the rest pose. "keep_shape": it is in the rest pose
            already. "automatic": detect which.
        replace: whether to unbind the target from other armatures; otherwise a bound target is rejected.
        move_rig: whether to bind it to a copy of the armature whose bones are moved into the target.
    """

    shape: Literal["automatic", "rest_pose", "keep_shape"] = "automatic"
    replace: bool = False
    move_rig: bool = False


def parse_names(text: str) -> tuple[str, ...]:
    """Split names at commas."""
    return tuple(filter(None, (name.strip() for name in text.split(","))))


def parse_group_names(text: str) -> dict[str, str]:
    """New names of vertex groups by the old ones, from comma-separated `old = new` pairs.

    Raises:
        MeshError: the text does not have that form.
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
