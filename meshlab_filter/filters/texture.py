# SPDX-License-Identifier: GPL-3.0-or-later
"""A filter that bakes the source's textures into an image for the target's own texture coordinates."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import zoomout_core as zo
from meshlab_filter.catalogue import mesh_filter
from meshlab_filter.filters.match_parameters import MATCHING, SOURCE, STORED_OR_NEW, TARGET
from meshlab_filter.filters.matches import find_correspondence
from meshlab_filter.layer import TEXCOORD, Layer
from meshlab_filter.mesh_data import add_layer, check_target, custom_names, read_layer
from meshlab_filter.parameters import COUNT, TEXT, Parameter
from meshlab_filter.textures import Textures, image_of, pixels
from zoomout_core.messages import plural_warning
from zoomout_core.runtime.progress import portion
from zoomout_core.transfer import Attribute, Domain, Kind, map_target
from zoomout_core.transfer.uv.bake import Picture, bake

if TYPE_CHECKING:
    from pymeshlab import MeshSet

# Maximum width and height of an image in texels: 1 GB.
MAX_TEXELS = 1 << 14


@mesh_filter(
    SOURCE,
    TARGET,
    Parameter("textname", TEXT, "baked.png", "File name of the baked PNG image."),
    Parameter("textw", COUNT, 1024, "Width of the image, in texels."),
    Parameter("texth", COUNT, 1024, "Height of the image, in texels."),
    STORED_OR_NEW,
    *MATCHING,
)
def transfer_texture_by_zoomout(
    ms: MeshSet,
    *,
    sourcemesh: int,
    targetmesh: int,
    textname: str,
    textw: int,
    texth: int,
    correspondence: str,
    **matching: Any,
) -> dict[str, Any]:
    """Bake the source's textures into an image for the target's own texture coordinates, without visible seams.

    The result is a new layer, which becomes current: a copy of the target with the image as its texture. Each texel is
    interpolated at its corresponding point on the source, within one island; gutters repeat the nearest texel.

    Returns:
        `mesh_id` of the new layer; `confidence`, an array for each vertex; `candidates` and `certainty`, unless the
        correspondence was stored; `notes`, sentences for the user.

    Raises:
        MeshError: a mesh is missing or unusable, the source has no texture, or the target no texture coordinates.
        ValueError: arguments that do not fit together.
    """
    for name, count in (("textw", textw), ("texth", texth)):
        if not 1 <= count <= MAX_TEXELS:
            raise ValueError(f"'{name}' is {count}: give a whole number from 1 to {MAX_TEXELS}.")
    source = read_layer(ms, sourcemesh)
    target = read_layer(ms, targetmesh, custom_names(ms, targetmesh))
    picture = _picture(source)
    atlas = _atlas(target)
    check_target(target)
    with portion(0.0, 0.7):
        found, report = find_correspondence(ms, source, target, targetmesh, correspondence, **matching)
    mapped = map_target(found, source.surface, target.surface)
    with portion(0.7, 1.0):
        baked = bake(mapped, [picture], atlas, textw, texth)
    image = np.asarray(baked.images[0], dtype=np.uint8)  # no triangle lacks a texture
    name = f"{Path(textname).stem or 'baked'}.png"
    number = np.zeros(len(target.faces), dtype=np.int64)
    new = replace(
        target,
        label=f"{target.label}_baked",
        components={**target.components, TEXCOORD: Attribute(TEXCOORD, Domain.CORNER, Kind.UV, atlas)},
        textures=Textures.of([name], {name: image_of(image)}, atlas, number),
    )
    outside = int(baked.outside.sum())
    notes = [*report["notes"]]
    if outside:
        notes.append(
            plural_warning(
                outside,
                "1 face of layer '{name}' is outside the unit square, and was not baked: move its UVs.",
                "{count:,} faces of layer '{name}' are outside the unit square, and were not baked: move their UVs.",
                name=target.label,
            )
        )
    return {**report, "mesh_id": add_layer(ms, new), "notes": notes}


def _picture(source: Layer) -> Picture:
    """The images of a source."""
    textures = source.textures
    if textures is None or not textures.names:
        raise zo.MeshError(f"Layer '{source.label}' has no texture to bake: check which mesh is the source.")
    uv, number = textures.by_texture(source.components[TEXCOORD].values)
    used = [textures.names[each] for each in textures.numbers if each >= 0]
    absent = [name for name in used if name not in textures.images]
    if absent:
        raise zo.MeshError(
            f"The MeshSet has no image for {' and '.join(absent)}: load the mesh from its file, because pymeshlab "
            "does not copy images between MeshSets."
        )
    if len(used) < len(textures.numbers):
        raise zo.MeshError(
            f"Layer '{source.label}' has faces without a texture: assign a texture to them, or remove them."
        )
    return Picture(pixels([textures.images[name] for name in used]), np.searchsorted(textures.numbers, number), uv)


def _atlas(target: Layer) -> Any:
    """The target's own texture coordinates (3 m, 2)."""
    if target.textures is None:
        raise zo.MeshError(
            f"Layer '{target.label}' has no texture coordinates to bake to: create some, for example with the filter "
            "compute_texcoord_parametrization_triangle_trivial_per_wedge."
        )
    if len(target.textures.numbers) > 1:
        raise zo.MeshError(
            f"Layer '{target.label}' has {len(target.textures.numbers)} textures, but only one image can be baked: "
            "combine its texture coordinates into one layout."
        )
    return target.textures.by_texture(target.components[TEXCOORD].values)[0]
