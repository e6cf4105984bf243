# SPDX-License-Identifier: GPL-3.0-or-later
"""Split an avatar file into its body and its worn parts, by the names of its meshes and materials."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from zoomout_core.arrays import Booleans, Floats, Integers
from zoomout_core.assets.asset import MATERIALS, Asset
from zoomout_core.assets.part_names import matches
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.opening import shown
from zoomout_core.mesh.surface import Surface
from zoomout_core.transfer.attribute import Domain
from zoomout_core.transfer.groups import expand_ranges

# Words in names of parts of the body, and of worn parts, such as those of VRoid, VRChat and MakeHuman.
OF_BODY = re.compile(
    r"body|skin|face|head(?!band|phone|set|dress)|eye(?!glass|wear)|iris|pupil|lash|brow|mouth|lip|teeth|tooth|tongue"
    r"|gum|ear(?!ring)|nail|hand(?!bag)|foot(?!wear)|feet|human|base ?mesh"
)
OF_WORN = re.compile(
    r"cloth|wear|hair|wig|braid|tops?\b|bottom|shirt|blouse|jacket|coat|hood|vest|sweater|dress|skirt|pants|trouser"
    r"|jeans|shorts|suit|uniform|kimono|underwear|bra\b|panty|sock|stocking|tights|shoe|boot|sandal|heel|glove|hat\b|cap\b"
    r"|helmet|glass|mask|belt|bag|ribbon|scarf|tie\b|necklace|collar|ring\b|accessor|armor|armour|outfit|tail|wing|horn"
)
# Words in names of hair, but not of hair-like cloth, of things worn in hair, or of tools for it.
OF_HAIR = re.compile(
    r"(?<!c)(?<!mo)hair(?!y|less| ?(band|pin|clip|tie|net|bow|ribbon|ornament|accessor|brush|comb|stick|dryer))"
    r"|\bwig\b|braids?\b|bangs\b|ahoge|(pony|pig|twin) ?tail"
)
OF_HAIR_IN_JAPANESE = re.compile(
    "髪(?!飾|留|止|紐|ゴム)|ヘア(?!バンド|ピン|クリップ|ゴム|アクセ|ネット|ブラシ|リボン)"
    "|三つ編み|おさげ|もみあげ|ポニーテール|ツインテール|アホ毛"
)


class AvatarParts(NamedTuple):
    """An avatar file in two parts.

    Attributes:
        body: the body; the whole file if nothing is worn.
        worn: the parts that it wears; None without any.
    """

    body: Asset
    worn: Asset | None


def split_avatar(asset: Asset, body: Sequence[str] = (), *, wears: bool = True) -> AvatarParts:
    """Split an avatar file into its body and its worn parts.

    Args:
        asset: the file.
        body: patterns of the names of meshes or materials of the body, such as `Body*`. If omitted, words in these
            names decide.
        wears: whether it must have both. If not, parts of unknown names belong to the body, and patterns that match
            none of its parts are ignored: they name parts of outfits.

    Raises:
        MeshError: it must have both, but does not, or none of its parts has a name of the body.
    """
    names, part = _named_parts(asset)
    of_body = np.array(are_of_body(names, body, wears=wears))[part]
    return AvatarParts(keep_faces(asset, of_body), None if of_body.all() else keep_faces(asset, ~of_body))


def are_of_body(names: Sequence[Sequence[str]], body: Sequence[str] = (), *, wears: bool = True) -> list[bool]:
    """Whether parts of an avatar belong to its body, by the names of each part, the most significant one first.

    For the other arguments, see `split_avatar`.

    Raises:
        MeshError: it must have a body and worn parts, but does not, or none of its names is of the body.
    """
    found = [_is_of_body(each, body) for each in names]
    if not wears and not any(found):
        found = [_is_of_body(each, ()) for each in names]
    known = [(not wears) if kind is None else kind for kind in found]
    if not wears and not any(known):
        raise MeshError(
            f"None of its parts is named like one of a body ({_name_list(names)}): name those of the body with --body."
        )
    if body and not any(known):
        raise MeshError(f"--body matches none of its parts ({_name_list(names)}): correct the pattern.")
    if wears and all(known) and (body or None not in found):
        raise MeshError(
            f"All of its parts belong to the body ({_name_list(names)}): give an avatar that wears something, or name "
            "those of the body with --body."
        )
    if wears and (all(known) or not any(known)):
        raise MeshError(
            "The names of the parts do not show which belong to the body and which are worn "
            f"({_name_list(names)}): name those of the body with --body."
        )
    return known


def _name_list(names: Sequence[Sequence[str]]) -> str:
    """The names of parts, for messages."""
    return ", ".join(dict.fromkeys(shown("/".join(filter(None, name))) for name in names))


def is_hair(name: str, materials: Sequence[str]) -> bool:
    """Whether a worn object is hair, by its name; by those of all its materials if its own names nothing worn."""
    if _names_hair(name) or OF_WORN.search(_words(name)):
        return _names_hair(name)
    return bool(materials) and all(map(_names_hair, materials))


def _names_hair(name: str) -> bool:
    return bool(OF_HAIR.search(_words(name)) or OF_HAIR_IN_JAPANESE.search(name))


def hair_objects(asset: Asset) -> list[bool]:
    """Whether each object of an asset is hair."""
    owner, material = _owner_and_material(asset)
    found = []
    for number, (name, _) in enumerate(asset.objects):
        used = np.unique(material[owner == number]).tolist()
        found.append(is_hair(name, [asset.materials[each].name if each >= 0 else "" for each in used]))
    return found


def surfaces_of_objects(asset: Asset) -> list[Surface]:
    """The surface of each object of an asset, in the order of the vertices."""
    surface, ends = asset.surface, np.cumsum([0, *(count for _, count in asset.objects)])
    first = surface.corner_vertex[surface.face_start[:-1]]
    found = []
    for start, stop in pairwise(ends.tolist()):
        faces = np.flatnonzero((first >= start) & (first < stop))
        corners = slice(surface.face_start[faces[0]], surface.face_start[faces[-1] + 1])
        starts = surface.face_start[faces[0] : faces[-1] + 2] - surface.face_start[faces[0]]
        found.append(Surface.from_corners(surface.vertices[start:stop], surface.corner_vertex[corners] - start, starts))
    return found


def mask_of(asset: Asset, patterns: Sequence[str]) -> Floats:
    """A mask (n,): 1 at vertices of meshes or materials whose names match one of some patterns, otherwise 0."""
    surface, (names, part) = asset.surface, _named_parts(asset)
    chosen = np.array([matches(name, patterns) for name in names])[part]
    mask = np.zeros(len(surface.vertices))
    mask[surface.corner_vertex[np.repeat(chosen, np.diff(surface.face_start))]] = 1
    return mask


def _named_parts(asset: Asset) -> tuple[list[tuple[str, str]], Integers]:
    """The names of the material and of the mesh of each part, and (f,) the number of each face's part."""
    pairs, part = np.unique(np.column_stack(_owner_and_material(asset)), axis=0, return_inverse=True)
    names = [
        (asset.materials[number].name if number >= 0 else "", asset.objects[mesh][0]) for mesh, number in pairs.tolist()
    ]
    return names, part.ravel()


def _owner_and_material(asset: Asset) -> tuple[Integers, Integers]:
    """(f,) the numbers of each face's object and material, -1 without a material."""
    first = asset.surface.corner_vertex[asset.surface.face_start[:-1]]
    owner = np.repeat(np.arange(len(asset.objects)), [count for _, count in asset.objects])
    materials = asset.find(MATERIALS)
    return owner[first], np.full(len(first), -1) if materials is None else np.asarray(materials.values)


def _words(name: str) -> str:
    """The words of a name, in lower case."""
    return re.sub(r"[^a-z]+", " ", re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower())


def _is_of_body(names: Sequence[str], patterns: Sequence[str]) -> bool | None:
    """Whether a part belongs to the body; None if its names are not known."""
    if patterns:
        return matches(names, patterns)
    for name in names:
        words = _words(name)
        if OF_WORN.search(words):
            return False
        if OF_BODY.search(words):
            return True
    return None


def keep_faces(asset: Asset, chosen: Booleans) -> Asset:
    """Keep chosen faces (f,) of an asset, with their vertices and data."""
    surface = asset.surface
    faces = np.flatnonzero(chosen)
    owner, corners = expand_ranges(surface.face_start[faces], surface.face_start[faces + 1])
    used, corner_vertex = np.unique(surface.corner_vertex[corners], return_inverse=True)
    starts = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=len(faces)))])
    rows = {Domain.POINT: used, Domain.CORNER: corners, Domain.FACE: faces}
    attributes = tuple(
        replace(each, values=np.asarray(each.values)[rows[each.domain]])
        for each in asset.attributes
        if each.domain in rows
    )
    ends = np.cumsum([0, *(count for _, count in asset.objects)])
    counts = np.diff(np.searchsorted(used, ends)).tolist()
    kept = [number for number, count in enumerate(counts) if count]
    skin = asset.skin
    if skin is not None:
        weights = csr_array(skin.weights[used])
        skin = replace(skin, rest=skin.rest[used], linear=skin.linear[used], weights=weights)
    return replace(
        asset,
        surface=Surface.from_corners(surface.vertices[used], corner_vertex.ravel(), starts),
        attributes=attributes,
        skin=skin,
        objects=tuple((asset.objects[number][0], counts[number]) for number in kept),
        nodes=tuple(asset.nodes[number] for number in kept if asset.nodes),
        stored_map=None,  # it has a row for each vertex of the whole
    )
