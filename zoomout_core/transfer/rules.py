# SPDX-License-Identifier: GPL-3.0-or-later
"""The rules of transfer: one row for each kind of value, which defines how it may be mixed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from inspect import signature
from numbers import Real
from typing import Any, Protocol

import numpy as np
from scipy.sparse import issparse

from zoomout_core.arrays import Booleans, Floats
from zoomout_core.maps.surface_map import SurfaceMap, fault_of_map
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.memory import memory_in_words
from zoomout_core.mesh.shapes import ShapeLike, as_placed_surface
from zoomout_core.mesh.surface import Surface
from zoomout_core.runtime.threads import on_one_blas_thread
from zoomout_core.transfer.attribute import Attribute, Domain, Kind, element_count
from zoomout_core.transfer.continuation import extrapolate_map
from zoomout_core.transfer.edges.transfer_edges import snap_marks, transfer_edges
from zoomout_core.transfer.finite import with_finite_values
from zoomout_core.transfer.interpolate import MIX, VOTE
from zoomout_core.transfer.keys.shape_keys import conform_target, transfer_offsets
from zoomout_core.transfer.mapped_target import MappedTarget
from zoomout_core.transfer.normals import turn_directions, turn_normals
from zoomout_core.transfer.rigging.weights import mix_weights
from zoomout_core.transfer.rotations import mix_matrices, mix_quaternions
from zoomout_core.transfer.uv.transfer_uv import transfer_uv


class Match(Protocol):
    """The result of a match: the map, its confidence, and which vertices have a partner; None for all."""

    @property
    def surface_map(self) -> SurfaceMap: ...

    @property
    def confidence(self) -> Floats: ...

    @property
    def has_partner(self) -> Booleans | None: ...


@dataclass(frozen=True)
class Rule:
    """How values of one kind are transferred, and their required format.

    Attributes:
        domains: for each domain the function (attribute, mapped, **options) -> attribute on the target.
        widths: allowed numbers of columns; 0 means values without a second axis.
        dtypes: numpy's letters for the allowed types of values.
        meaning: the same in words, for the user.
        bounded: whether squares of the values must be finite.
        sparse: whether values must be a sparse array.
        column: the shape of each column; () for numbers.
        mixable: whether values can be mixed, like numbers; otherwise one or the other is taken.
        mirrorable: whether such values have a mean for both sides of a symmetry, or a substitute for it.
    """

    domains: Mapping[Domain, Callable[..., Attribute]]
    widths: range
    dtypes: str
    meaning: str
    bounded: bool = False
    sparse: bool = False
    column: tuple[int, ...] = ()
    mixable: bool = False
    mirrorable: bool = False


ON_FACES = Domain.POINT, Domain.FACE, Domain.CORNER
MIXED = {**MIX, Domain.EDGE: transfer_edges}
VOTED = {**VOTE, Domain.EDGE: transfer_edges}
ANY = 1 << 30
# Larger numbers overflow when their squares are added.
LARGEST_VALUE = np.float64(1e75)  # which a comparison does not round to the single precision of values

RULES: dict[Kind, Rule] = {
    Kind.SCALAR: Rule(MIXED, range(1), "fiu", "one number each", bounded=True, mixable=True, mirrorable=True),
    Kind.VECTOR: Rule(
        MIXED, range(1, ANY), "fiu", "a row of numbers each", bounded=True, mixable=True, mirrorable=True
    ),
    Kind.DIRECTION: Rule(dict.fromkeys(ON_FACES, turn_directions), range(3, 4), "f", "three floats each", bounded=True),
    Kind.NORMAL: Rule(dict.fromkeys(ON_FACES, turn_normals), range(3, 4), "f", "three floats each", bounded=True),
    Kind.COLOR: Rule(
        MIXED, range(3, 5), "f", "three or four scene-linear floats each", bounded=True, mixable=True, mirrorable=True
    ),
    Kind.UV: Rule({Domain.CORNER: transfer_uv}, range(2, 3), "f", "two floats each", bounded=True),
    Kind.QUATERNION: Rule(
        dict.fromkeys(ON_FACES, mix_quaternions), range(4, 5), "f", "four floats each, w first", bounded=True
    ),
    Kind.MATRIX: Rule(
        dict.fromkeys(ON_FACES, mix_matrices),
        range(16, 17),
        "f",
        "sixteen floats each, those of a 4x4 matrix row by row",
        bounded=True,
    ),
    Kind.LABEL: Rule(VOTED, range(ANY), "iuUSO", "integers or strings"),
    Kind.BOOLEAN: Rule(VOTED, range(1), "b", "true or false each", mirrorable=True),
    Kind.MARK: Rule(
        {Domain.POINT: snap_marks, Domain.EDGE: transfer_edges},
        range(1),
        "f",
        "one float each, zero where there is no mark",
        bounded=True,
        mirrorable=True,
    ),
    Kind.WEIGHT: Rule(
        {Domain.POINT: mix_weights},
        range(1, ANY),
        "f",
        "a scipy.sparse array of floats",
        bounded=True,
        sparse=True,
        mixable=True,
        mirrorable=True,
    ),
    Kind.OFFSET: Rule(
        {Domain.POINT: transfer_offsets},
        range(1, ANY),
        "f",
        "three floats for each key",
        bounded=True,
        column=(3,),
        mixable=True,
    ),
}


@memory_in_words
@on_one_blas_thread
def transfer(
    attribute: Attribute,
    result: Match | SurfaceMap,
    source: ShapeLike | None = None,
    target: ShapeLike | None = None,
    fill_below: float | None = None,
    **options: Any,
) -> Attribute:
    """Transfer an attribute of the source to the target.

    Vertices without a partner on the source are filled in. Numbers, colours, weights and shape keys are continued
    smoothly from their surroundings; other kinds take the nearest value along the surface. To keep the target's own
    values there, `blend` with the match's `has_partner` as the mask.

    Args:
        attribute: an attribute of the source.
        result: the match, or only its map, of each target vertex to a point of the source.
        source: the surface with the attribute; the match's, when not given.
        target: the surface that receives it; the match's, when not given.
        fill_below: numbers, colours and weights of vertices with less confidence are filled in from around them, see
            `inpaint`; None to keep all mapped values.
        options: options of the attribute's kind; for weights see `weights.mix_weights`.

    Returns:
        The attribute with values for the target; its notes name places that the user should check.

    Raises:
        MeshError: the kind cannot be transferred on its domain, the values do not fit the source, or the map
            is of other surfaces.
        ValueError: `fill_below` is not a confidence.
        TypeError: the attribute, the match or a surface has another type, or a bare map comes without surfaces.

    Example:
        >>> heights = zo.Attribute("height", zo.Domain.POINT, zo.Kind.SCALAR, source.vertices[:, 2])
        >>> zo.transfer(heights, result).values.shape == (len(target.vertices),)
        True
    """
    if not isinstance(attribute, Attribute):
        raise TypeError(f"An Attribute is needed, not a {type(attribute).__name__}: give its name, domain and kind.")
    return transfer_along(attribute, map_target(result, source, target, fill_below), **options)


def map_target(
    result: Match | SurfaceMap,
    source: ShapeLike | None = None,
    target: ShapeLike | None = None,
    fill_below: float | None = None,
) -> MappedTarget:
    """Prepare the shared part of a transfer of many attributes, for `transfer_along`; arguments as for `transfer`.

    Raises:
        MeshError: the map is of other surfaces.
        ValueError: `fill_below` is not a confidence.
    """
    if fill_below is not None and not (isinstance(fill_below, Real) and 0 <= fill_below <= 1):
        raise ValueError(f"fill_below is {fill_below!r}: give a confidence from 0 to 1, or None.")
    if not isinstance(result, SurfaceMap) and not hasattr(result, "surface_map"):
        raise TypeError(
            f"A match is needed, not a {type(result).__name__}: give the result of `match`, or its surface_map."
        )
    source, target = surfaces_of(result, source, target)
    if isinstance(result, SurfaceMap):
        _check_map(result, source, target)
        return MappedTarget(source, target, result, np.ones(len(target.vertices)), fill_below)
    surface_map, confidence, has_partner = result.surface_map, np.asarray(result.confidence), result.has_partner
    _check_map(surface_map, source, target, confidence, *([] if has_partner is None else [has_partner]))
    if has_partner is not None:
        surface_map = extrapolate_map(surface_map, target, has_partner)
        confidence = np.where(has_partner, confidence, 0)
    return MappedTarget(source, target, surface_map, confidence, fill_below, has_partner)


def surfaces_of(
    result: Match | SurfaceMap, source: ShapeLike | None, target: ShapeLike | None
) -> tuple[Surface, Surface]:
    """The surfaces of a transfer: the given ones, otherwise those of the match.

    Raises:
        TypeError: no surfaces are given, and the match has none, such as a bare map.
    """
    source = getattr(result, "source", None) if source is None else source
    target = getattr(result, "target", None) if target is None else target
    if source is None or target is None:
        raise TypeError(f"A {type(result).__name__} does not contain its surfaces: give source and target as well.")
    return as_placed_surface(source), as_placed_surface(target)


def transfer_along(attribute: Attribute, mapped: MappedTarget, **options: Any) -> Attribute:
    """`transfer` of one of many attributes, which share the computations on the map."""
    rule = _rule(attribute)
    _check_format(attribute, rule, mapped.source)
    attribute = with_finite_values(attribute, mapped.source)
    _check_numbers(attribute, rule)
    function = rule.domains[attribute.domain]
    _check_options(options, attribute.kind, function)
    return function(attribute, mapped, **options)


@memory_in_words
@on_one_blas_thread
def conform(result: Match | SurfaceMap, source: ShapeLike | None = None, target: ShapeLike | None = None) -> Floats:
    """The source's shape on the target's vertices: (n_t, 3) positions on the source.

    Where confidence is low, the target keeps more of its own shape, rotated and scaled with its surroundings.

    Raises:
        MeshError: the map is of other surfaces.

    Example:
        >>> zo.conform(result).shape == target.vertices.shape
        True
    """
    return conform_target(map_target(result, source, target))


def _rule(attribute: Attribute) -> Rule:
    kind, domain = attribute.kind.name.lower(), attribute.domain.name.lower()
    if attribute.kind not in RULES:
        able = ", ".join(known.name.lower() for known in RULES)
        raise MeshError(
            f"'{attribute.name}' is of the kind {kind}, which cannot be transferred yet; these can: {able}."
        )
    rule = RULES[attribute.kind]
    if attribute.domain not in rule.domains:
        able = " or ".join(known.name.lower() for known in rule.domains)
        raise MeshError(
            f"'{attribute.name}' has a {kind} for each {domain}, which cannot be transferred yet; "
            f"give one for each {able}."
        )
    return rule


def _check_options(options: Mapping[str, Any], kind: Kind, function: Callable[..., Attribute]) -> None:
    known = list(signature(function).parameters)[2:]
    unknown = [name for name in options if name not in known]
    if unknown:
        choice = f"choose from {', '.join(known)}" if known else "leave it out, since there are none"
        raise TypeError(f"The kind {kind.name.lower()} has no option {unknown[0]}: {choice}.")


def _check_format(attribute: Attribute, rule: Rule, source: Surface) -> None:
    name, domain = attribute.name, attribute.domain
    values: Any = attribute.values if issparse(attribute.values) else np.asarray(attribute.values)
    needs = f"the kind {attribute.kind.name.lower()} needs {rule.meaning}"
    if issparse(values) != rule.sparse:
        raise MeshError(f"The values of '{name}' are a {type(attribute.values).__name__}, but {needs}.")
    count = element_count(domain, source)
    given, *columns = values.shape or (1,)
    if given != count:
        unit = domain.name.lower()
        raise MeshError(f"'{name}' has {given} values for {count} {unit}s of the source: give one for each.")
    if tuple(columns[1:]) != rule.column or sum(columns[:1]) not in rule.widths or values.dtype.kind not in rule.dtypes:
        raise MeshError(f"'{name}' has values of type {values.dtype} and shape {values.shape}, but {needs}.")
    labelled = attribute.labels and attribute.kind in (Kind.WEIGHT, Kind.OFFSET)
    if labelled and columns[:1] != [len(attribute.labels)]:
        raise MeshError(f"'{name}' has {len(attribute.labels)} labels for {sum(columns[:1])} columns: give one each.")
    if values.dtype.kind == "O" and not all(isinstance(value, str) for value in values.flat):
        raise MeshError(f"'{name}' has values that are not all text, but {needs}.")


def _check_numbers(attribute: Attribute, rule: Rule) -> None:
    name, values = attribute.name, attribute.values
    numbers = values.data if rule.sparse else np.asarray(values)
    if rule.bounded and (huge := np.abs(numbers) > LARGEST_VALUE).any():
        raise MeshError(
            "'{name}' has {count:,} values that are far too large: correct them.", name=name, count=huge.sum()
        )


def _check_map(surface_map: SurfaceMap, source: Surface, target: Surface, *of_vertices: Floats | Booleans) -> None:
    vertices, triangles = len(target.vertices), len(source.triangles)
    if len(surface_map.triangle) != vertices or any(values.shape != (vertices,) for values in of_vertices):
        raise MeshError(
            f"The map is for {len(surface_map.triangle)} vertices, but the target has {vertices}: "
            "match these two surfaces again."
        )
    if len(surface_map.source_triangles) != triangles:
        raise MeshError(
            f"The map refers to {len(surface_map.source_triangles)} triangles, but the source has {triangles}: match "
            "these two surfaces again."
        )
    fault = fault_of_map(surface_map.triangle, surface_map.barycentric, triangles)
    if fault:
        raise MeshError("The map cannot be used, because {fault}: match these two surfaces again.", fault=fault)
