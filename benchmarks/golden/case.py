# SPDX-License-Identifier: GPL-3.0-or-later
"""A case of `golden`, and the fields that are recorded of its results."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from scipy.sparse import issparse

import zoomout_core as zo

Fields: TypeAlias = dict[str, Any]

# Number of hexadecimal digits of a stored hash.
DIGITS = 16
# Options of matches that need not be precise.
FAST: dict[str, Any] = {"k_final": 60, "samples": 500, "proxy_vertices": 2000}


@dataclass(frozen=True)
class Case:
    """A computation with recorded results.

    Attributes:
        name: its first word is the sort.
        fields: computes the recorded results, given the folder of the sets, from new shapes without cached results.
        needs: files in that folder.
    """

    name: str
    fields: Callable[[Path], Fields]
    needs: tuple[str, ...] = ()

    @property
    def sort(self) -> str:
        """The first word of the name."""
        return self.name.split()[0]


def hash_of(*arrays: Any) -> str:
    """A hash of the bytes of arrays, dense or sparse."""
    digest = sha256()
    for array in arrays:
        for each in ("data", "indices", "indptr") if issparse(array) else (None,):
            digest.update(np.ascontiguousarray(array if each is None else getattr(array, each)).tobytes())
    return digest.hexdigest()[:DIGITS]


def of_map(surface_map: zo.SurfaceMap) -> Fields:
    """The fields of a map."""
    return {"triangle": hash_of(surface_map.triangle), "barycentric": hash_of(surface_map.barycentric)}


def of_match(result: zo.MatchResult) -> Fields:
    """The fields of a match."""
    return of_map(result.surface_map) | {
        "confidence": hash_of(result.confidence),
        "functional_map": hash_of(result.functional_map),
        "partners": hash_of(result.has_partner, result.source_has_partner),
        "certainty": repr(float(result.certainty)),
        "candidates": hash_of([candidate.certainty for candidate in result.candidates]),
        "notes": list(result.notes),
    }


def of_symmetries(found: tuple[zo.Symmetry, ...]) -> Fields:
    """The fields of symmetries, numbered."""
    fields: Fields = {"count": len(found)}
    for number, symmetry in enumerate(found):
        each = of_map(symmetry.surface_map) | {
            "confidence": hash_of(symmetry.confidence),
            "functional_map": hash_of(symmetry.functional_map),
            "distance": hash_of(symmetry.distance),
            "order": symmetry.order,
            "certainty": repr(float(symmetry.certainty)),
            "scores": {name: repr(float(score)) for name, score in symmetry.scores.items()},
            "return_error": repr(float(symmetry.return_error)),
            "origin": symmetry.origin,
            "notes": list(symmetry.notes),
        }
        fields |= with_prefix(str(number), each)
    return fields


def of_collection(result: zo.CollectionResult) -> Fields:
    """The fields of the maps of a collection, by pair."""
    fields: Fields = {"failures": result.failures, "matched": result.matched}
    for pair, record in sorted(result.records.items()):
        each = of_map(result.surface_map(pair.source, pair.target)) | {
            "certainty": repr(float(record.certainty)),
            "candidate": record.candidate,
            "through": record.through,
            "notes": list(record.notes),
        }
        fields |= with_prefix(f"{pair.source} {pair.target}", each)
    return fields


def of_attribute(attribute: zo.Attribute) -> Fields:
    """The fields of an attribute."""
    return {"values": hash_of(attribute.values), "labels": list(attribute.labels), "notes": list(attribute.notes)}


def of_basis(basis: zo.SpectralBasis) -> Fields:
    """The fields of a basis."""
    return {name: hash_of(getattr(basis, name)) for name in ("eigenvalues", "eigenvectors", "areas")}


def with_prefix(prefix: str, fields: Fields) -> Fields:
    """Fields whose names begin with a prefix."""
    return {f"{prefix} {name}": value for name, value in fields.items()}
