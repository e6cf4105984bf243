# SPDX-License-Identifier: GPL-3.0-or-later
"""Dense correspondence between surfaces by spectral upsampling (ZoomOut), and attribute transfer with it.

Names are imported on first use, so that programs need not wait for unused parts of scipy. The same holds for the
modules `plotting`, which needs matplotlib, and `samples`.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zoomout_core import plotting as plotting
    from zoomout_core import samples as samples
    from zoomout_core.assets.asset import Asset
    from zoomout_core.assets.files import read_asset, write_asset
    from zoomout_core.assets.transfer_asset import transfer_asset
    from zoomout_core.collection.collection import CollectionResult, match_collection
    from zoomout_core.evaluation import geodesic_error
    from zoomout_core.geometry.shot import shot
    from zoomout_core.library.found import FoundPart, FoundSource, FoundSources
    from zoomout_core.library.library import Library, Preparation, find_source
    from zoomout_core.maps.consistent_zoomout import ConsistentMaps, consistent_zoomout
    from zoomout_core.maps.descriptor_fit import fit_functional_map
    from zoomout_core.maps.functional_map import (
        commutativity_error,
        functional_map_of,
        orthonormality_error,
        precise_map_of,
        vertex_map_of,
    )
    from zoomout_core.maps.surface_map import SurfaceMap
    from zoomout_core.maps.zoomout import zoomout, zoomout_both_ways
    from zoomout_core.maps.zoomout_sizes import slanted_sizes
    from zoomout_core.matching.options import MatchOptions
    from zoomout_core.matching.pipeline import match
    from zoomout_core.matching.preparation.memory_cache import forget_shapes, store_shapes
    from zoomout_core.matching.proximity import ProximityMatch, match_by_proximity
    from zoomout_core.matching.ranking.mirror_image import mirror_candidate
    from zoomout_core.matching.report.verdict import Verdict
    from zoomout_core.matching.result import MatchResult, load_result
    from zoomout_core.matching.transfer_landmarks import TransferredLandmarks, transfer_landmarks
    from zoomout_core.mesh.errors import MeshError
    from zoomout_core.mesh.formats.files import read_point_cloud, read_surface
    from zoomout_core.mesh.point_cloud import PointCloud
    from zoomout_core.mesh.surface import Surface
    from zoomout_core.runtime.progress import Cancelled, Progress, progress
    from zoomout_core.runtime.threads import set_threads
    from zoomout_core.spectral.descriptors import (
        heat_kernel_map,
        heat_kernel_signature,
        wave_kernel_map,
        wave_kernel_signature,
    )
    from zoomout_core.spectral.eigenbasis import SpectralBasis, eigenbasis
    from zoomout_core.spectral.hamiltonian import hamiltonian_basis
    from zoomout_core.spectral.operators import multiplication_operators, orientation_operators
    from zoomout_core.symmetry.detect import Symmetry, detect_symmetry
    from zoomout_core.transfer import (
        Attribute,
        Domain,
        Dressed,
        Kind,
        Lines,
        MovedJoints,
        Wrapped,
        conform,
        dress,
        follow_keys,
        move_joints,
        move_rig,
        transfer,
        wrap,
    )
    from zoomout_core.transfer.keys.face_landmarks import propose_face_landmarks
    from zoomout_core.transfer.keys.key_names import (
        TranslatedKeys,
        key_names,
        missing_key_names,
        recognise_key_names,
        translate_key_names,
        translate_offsets,
    )

    __version__: str

__all__ = [
    "Asset",
    "Attribute",
    "Cancelled",
    "CollectionResult",
    "ConsistentMaps",
    "Domain",
    "Dressed",
    "FoundPart",
    "FoundSource",
    "FoundSources",
    "Kind",
    "Library",
    "Lines",
    "MatchOptions",
    "MatchResult",
    "MeshError",
    "MovedJoints",
    "PointCloud",
    "Preparation",
    "Progress",
    "ProximityMatch",
    "SpectralBasis",
    "Surface",
    "SurfaceMap",
    "Symmetry",
    "TransferredLandmarks",
    "TranslatedKeys",
    "Verdict",
    "Wrapped",
    "commutativity_error",
    "conform",
    "consistent_zoomout",
    "detect_symmetry",
    "dress",
    "eigenbasis",
    "find_source",
    "fit_functional_map",
    "follow_keys",
    "forget_shapes",
    "functional_map_of",
    "geodesic_error",
    "hamiltonian_basis",
    "heat_kernel_map",
    "heat_kernel_signature",
    "key_names",
    "load_result",
    "match",
    "match_by_proximity",
    "match_collection",
    "mirror_candidate",
    "missing_key_names",
    "move_joints",
    "move_rig",
    "multiplication_operators",
    "orientation_operators",
    "orthonormality_error",
    "precise_map_of",
    "progress",
    "propose_face_landmarks",
    "read_asset",
    "read_point_cloud",
    "read_surface",
    "recognise_key_names",
    "set_threads",
    "shot",
    "slanted_sizes",
    "store_shapes",
    "transfer",
    "transfer_asset",
    "transfer_landmarks",
    "translate_key_names",
    "translate_offsets",
    "vertex_map_of",
    "wave_kernel_map",
    "wave_kernel_signature",
    "wrap",
    "write_asset",
    "zoomout",
    "zoomout_both_ways",
]

# The module of each name, as in the imports above.
_HOMES = {
    "assets.asset": ("Asset",),
    "assets.files": ("read_asset", "write_asset"),
    "assets.transfer_asset": ("transfer_asset",),
    "collection.collection": ("CollectionResult", "match_collection"),
    "evaluation": ("geodesic_error",),
    "geometry.shot": ("shot",),
    "library.library": ("Library", "Preparation", "find_source"),
    "library.found": ("FoundPart", "FoundSource", "FoundSources"),
    "maps.consistent_zoomout": ("ConsistentMaps", "consistent_zoomout"),
    "maps.descriptor_fit": ("fit_functional_map",),
    "maps.functional_map": (
        "commutativity_error",
        "functional_map_of",
        "orthonormality_error",
        "precise_map_of",
        "vertex_map_of",
    ),
    "maps.surface_map": ("SurfaceMap",),
    "maps.zoomout": ("zoomout", "zoomout_both_ways"),
    "maps.zoomout_sizes": ("slanted_sizes",),
    "matching.preparation.memory_cache": ("forget_shapes", "store_shapes"),
    "matching.ranking.mirror_image": ("mirror_candidate",),
    "matching.options": ("MatchOptions",),
    "matching.pipeline": ("match",),
    "matching.proximity": ("ProximityMatch", "match_by_proximity"),
    "matching.result": ("MatchResult", "load_result"),
    "matching.transfer_landmarks": ("TransferredLandmarks", "transfer_landmarks"),
    "matching.report.verdict": ("Verdict",),
    "mesh.errors": ("MeshError",),
    "mesh.formats.files": ("read_point_cloud", "read_surface"),
    "mesh.point_cloud": ("PointCloud",),
    "mesh.surface": ("Surface",),
    "runtime.progress": ("Cancelled", "Progress", "progress"),
    "runtime.threads": ("set_threads",),
    "spectral.descriptors": ("heat_kernel_map", "heat_kernel_signature", "wave_kernel_map", "wave_kernel_signature"),
    "spectral.eigenbasis": ("SpectralBasis", "eigenbasis"),
    "spectral.hamiltonian": ("hamiltonian_basis",),
    "spectral.operators": ("multiplication_operators", "orientation_operators"),
    "symmetry.detect": ("Symmetry", "detect_symmetry"),
    "transfer": (
        "Attribute",
        "Domain",
        "Dressed",
        "Kind",
        "Lines",
        "MovedJoints",
        "Wrapped",
        "conform",
        "dress",
        "follow_keys",
        "move_joints",
        "move_rig",
        "transfer",
        "wrap",
    ),
    "transfer.keys.face_landmarks": ("propose_face_landmarks",),
    "transfer.keys.key_names": (
        "TranslatedKeys",
        "key_names",
        "missing_key_names",
        "recognise_key_names",
        "translate_key_names",
        "translate_offsets",
    ),
}
_MODULES = ("plotting", "samples")
_HOME = {name: home for home, names in _HOMES.items() for name in names}


class _Package(ModuleType):
    """The package, in which `transfer` is the function, although a subpackage has the same name."""

    def __setattr__(self, name: str, value: object) -> None:
        if not (name in _HOME and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


if not TYPE_CHECKING:  # so that type checkers report unknown names

    def __getattr__(name: str) -> object:
        """Import a public name, a public module or `__version__` on first use."""
        if name in _MODULES:
            return import_module(f"{__name__}.{name}")
        if name in _HOME:
            value = globals()[name] = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
            return value
        if name == "__version__":
            from importlib.metadata import version

            return version("zoomout-core")
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    dunders = {name for name in globals() if name.startswith("__")}
    return sorted({*dunders, *__all__, *_MODULES, "__version__"})
