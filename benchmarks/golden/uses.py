# SPDX-License-Identifier: GPL-3.0-or-later
"""Cases of `golden` that use a map, such as transfers, and cases of bases and ZoomOut."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.sparse import csr_array

import zoomout_core as zo
from benchmarks.golden.case import FAST, Case, Fields, hash_of, of_attribute, of_basis, of_map, with_prefix
from benchmarks.golden.shapes import SMALL, USUAL, clothe, cloud, creature, creatures, landmarks, shirt, true_map
from zoomout_core import samples
from zoomout_core.mesh.triangles import unit_vectors


def attributes(surface: zo.Surface) -> list[zo.Attribute]:
    """One attribute of each kind on each of its domains, given by formulas."""
    domain, kind = zo.Domain, zo.Kind
    corners = surface.vertices[surface.corner_vertex]
    middles = np.add.reduceat(corners, surface.face_start[:-1]) / np.diff(surface.face_start)[:, None]
    places = {
        domain.POINT: surface.vertices,
        domain.EDGE: surface.vertices[surface.edges].mean(axis=1),
        domain.FACE: middles,
        domain.CORNER: corners,
    }
    values: dict[zo.Kind, Callable[[Any], Any]] = {
        kind.SCALAR: lambda p: np.sin(2 * p[:, 0]) + p[:, 2],
        kind.VECTOR: lambda p: np.cos(p[:, :2]),
        kind.DIRECTION: lambda p: unit_vectors(p + np.array([0, 0, 0.1])),
        kind.NORMAL: lambda p: unit_vectors(p + np.array([0, 0.1, 0])),
        kind.COLOR: lambda p: np.clip(0.5 + 0.2 * np.column_stack([p, p[:, 0]]), 0, 1),
        kind.UV: lambda p: 0.5 + 0.1 * p[:, [0, 2]],
        kind.QUATERNION: lambda p: unit_vectors(np.column_stack([2 + p[:, 0] ** 2, p])),
        kind.MATRIX: lambda p: (np.eye(4) + 0.1 * np.sin(p).sum(axis=1)[:, None, None]).reshape(-1, 16),
        kind.LABEL: lambda p: np.floor(2 * p[:, 2]).astype(int),
        kind.BOOLEAN: lambda p: p[:, 0] > 0.3,
        kind.MARK: lambda p: (np.abs(p[:, 2] - 0.2) < 0.06).astype(float),
        kind.WEIGHT: lambda p: csr_array(np.maximum(0, np.column_stack([p[:, 0], -p[:, 0], p[:, 2]]))),
        kind.OFFSET: lambda p: np.stack([0.1 * np.sin(3 * p), 0.05 * np.cos(p)], axis=1),
    }
    everywhere = tuple(domain)
    on_faces = domain.POINT, domain.FACE, domain.CORNER
    domains = dict.fromkeys(kind, on_faces) | dict.fromkeys(
        (kind.SCALAR, kind.VECTOR, kind.COLOR, kind.LABEL, kind.BOOLEAN), everywhere
    )
    domains |= {
        kind.UV: (domain.CORNER,),
        kind.MARK: (domain.POINT, domain.EDGE),
        kind.WEIGHT: (domain.POINT,),
        kind.OFFSET: (domain.POINT,),
    }
    return [
        zo.Attribute(f"{each.name.lower()} {on.name.lower()}", on, each, make(places[on]))
        for each, make in values.items()
        for on in domains[each]
    ]


def _transfer(source: zo.Surface, target: zo.Surface, result: Any, fill_below: float | None = None) -> Fields:
    fields: Fields = {}
    for attribute in attributes(source):
        fields |= with_prefix(attribute.name, of_attribute(zo.transfer(attribute, result, source, target, fill_below)))
    return fields | {"conform": hash_of(zo.conform(result, source, target))}


def _by_true_map() -> Fields:
    source, target = creatures()
    return _transfer(source, target, zo.SurfaceMap.from_vertices(true_map(), source))


def _by_match(target: zo.Surface) -> Fields:
    source = creature()
    return _transfer(source, target, zo.match(source, target, **FAST), 0.3)


def _of_asset() -> Fields:
    source, target = samples.character(2000), zo.Asset(samples.scan(1500).surface)
    moved = zo.transfer_asset(source, target, zo.match(source.surface, target.surface, **FAST))
    fields: Fields = {"received": list(moved.received), "notes": list(moved.notes)}
    for attribute in moved.asset.attributes:
        fields |= with_prefix(attribute.name, of_attribute(attribute))
    skin = moved.asset.skin
    return fields | ({} if skin is None else {"skin": hash_of(skin.weights, skin.inverse_bind, skin.rest)})


def _wrap(**options: Any) -> Fields:
    source, target = creature(USUAL), creature(SMALL, 1, 0.4)
    if options.pop("known", False):
        (of_source, _), (_, of_target) = landmarks(USUAL), landmarks(SMALL)
        options["landmarks"] = of_source, of_target
    if options.pop("upper", False):
        options["mask"] = (target.vertices[:, 2] > 0).astype(float)
    wrapped = zo.wrap(zo.match(source, target, **FAST), source, target, **options)
    return {
        "vertices": hash_of(wrapped.vertices),
        "turned_over": int(wrapped.turned_over),
        "notes": list(wrapped.notes),
    }


def _dress(**options: Any) -> Fields:
    source, target = creature(asymmetry=0), creature(seed=1, bend=0.4, asymmetry=0.2)
    tips = landmarks()[0]
    strands = np.concatenate([source.vertices[tips], 1.1 * source.vertices[tips]])
    hair = zo.Lines(strands, np.column_stack([np.arange(len(tips)), np.arange(len(tips)) + len(tips)]))
    dressed = zo.dress(zo.match(source, target, **FAST), source, target, [shirt(21), hair], **options)
    vertices = {f"vertices {number}": hash_of(each) for number, each in enumerate(dressed.vertices)}
    turns = {f"turns {number}": hash_of(each) for number, each in enumerate(dressed.turns)}
    return vertices | turns | {"notes": list(dressed.notes)}


def _bases(count: int = 3, k: int = 130) -> list[zo.SpectralBasis]:
    return [zo.eigenbasis(creature(1500, seed, 0.3 * seed), k) for seed in range(count)]


def _of_zoomout() -> Fields:
    source, target = _bases(2)
    vertex = true_map(count=1500)
    alone = zo.zoomout(source, target, vertex)
    from_functional = zo.zoomout(source, target, zo.functional_map_of(vertex, source, target, 20, 20), 100, step=3)
    there, back = zo.zoomout_both_ways(source, target, vertex)
    refined = {"vertices": alone, "functional": from_functional, "there": there, "back": back}
    fields = {
        f"{name} {field}": hash_of(getattr(each, field))
        for name, each in refined.items()
        for field in ("functional_map", "vertex")
    }
    precise = zo.precise_map_of(alone.functional_map, source, target, creature(1500))
    return fields | with_prefix("precise", of_map(precise))


def _of_consistent_zoomout() -> Fields:
    maps = {(a, b): true_map(a, b, 1500) for a, b in ((0, 1), (1, 2), (2, 0))}
    found = zo.consistent_zoomout(_bases(), maps, k_final=80)
    return {"latent": hash_of(*found.latent), "vertex": hash_of(found.vertex_map(0, 2))}


def _of_fit() -> Fields:
    source, target = _bases(2)
    here, there = (zo.wave_kernel_signature(basis, 40) for basis in (source, target))
    return {"signatures": hash_of(here, there), "fit": hash_of(zo.fit_functional_map(source, target, here, there))}


def _of_shape() -> Fields:
    surface = creature(1500)
    potential = np.clip(surface.vertices[:, 2], 0, 1)
    return {
        "shot": hash_of(zo.shot(surface)),
        **with_prefix("hamiltonian", of_basis(zo.hamiltonian_basis(surface, potential, 60))),
    }


def use_cases() -> list[Case]:
    """All cases of this module."""
    return [
        Case("transfer true map", lambda _: _by_true_map()),
        Case("transfer match", lambda _: _by_match(creature(SMALL, 1, 0.5))),
        Case("transfer match of part", lambda _: _by_match(creature(2000, 1, without=5))),
        Case("transfer asset", lambda _: _of_asset()),
        Case("wrap", lambda _: _wrap()),
        Case("wrap landmarks and mask", lambda _: _wrap(known=True, upper=True, smoothness=0.8, detail=0.5)),
        Case("wrap subdivided", lambda _: _wrap(subdivided=True)),
        Case("dress", lambda _: _dress()),
        Case("dress stiff", lambda _: _dress(stiffness=0.9, gap=0.02)),
        Case("basis mesh", lambda _: of_basis(zo.eigenbasis(creature()))),
        Case("basis cloud", lambda _: of_basis(zo.eigenbasis(cloud(creature(1500), True), 80, seed=2))),
        Case("basis shells", lambda _: of_basis(zo.eigenbasis(clothe(0, 0.0), 60))),
        Case("basis others", lambda _: _of_shape()),
        Case("zoomout", lambda _: _of_zoomout()),
        Case("zoomout consistent", lambda _: _of_consistent_zoomout()),
        Case("zoomout fit", lambda _: _of_fit()),
    ]
