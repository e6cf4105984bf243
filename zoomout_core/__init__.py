"""Dense correspondence between surfaces by spectral upsampling (ZoomOut), and attribute transfer with it."""

from zoomout_core.assets.asset import Asset
from zoomout_core.assets.files import read_asset, write_asset
from zoomout_core.assets.transfer_asset import transfer_asset, transfer_asset_steps
from zoomout_core.evaluation import geodesic_error
from zoomout_core.geometry.shot import shot
from zoomout_core.maps.descriptor_fit import fit_functional_map
from zoomout_core.maps.functional_map import (
    commutativity_error,
    functional_map_of,
    orthonormality_error,
    precise_map_of,
    vertex_map_of,
)
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.maps.zoomout import slanted_sizes, zoomout, zoomout_both_ways
from zoomout_core.matching.match import MatchResult, match, match_steps
from zoomout_core.matching.memory_cache import forget_shapes, store_shapes
from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.proximity import ProximityMatch, match_by_proximity, match_by_proximity_steps
from zoomout_core.mesh.files import read_point_cloud, read_surface
from zoomout_core.mesh.surface import MeshError, PointCloud, Surface
from zoomout_core.runtime.stepping import Progress, drain
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
from zoomout_core.symmetry.detect import Symmetry, detect_symmetry, detect_symmetry_steps
from zoomout_core.transfer import (
    Attribute,
    Domain,
    Dressed,
    Kind,
    Lines,
    Wrapped,
    conform,
    dress,
    dress_steps,
    transfer,
    wrap,
    wrap_steps,
)

__all__ = [
    "Asset",
    "Attribute",
    "Domain",
    "Dressed",
    "Kind",
    "Lines",
    "MatchOptions",
    "MatchResult",
    "MeshError",
    "PointCloud",
    "Progress",
    "ProximityMatch",
    "SpectralBasis",
    "Surface",
    "SurfaceMap",
    "Symmetry",
    "Wrapped",
    "commutativity_error",
    "conform",
    "detect_symmetry",
    "detect_symmetry_steps",
    "drain",
    "dress",
    "dress_steps",
    "eigenbasis",
    "fit_functional_map",
    "forget_shapes",
    "functional_map_of",
    "geodesic_error",
    "hamiltonian_basis",
    "heat_kernel_map",
    "heat_kernel_signature",
    "match",
    "match_by_proximity",
    "match_by_proximity_steps",
    "match_steps",
    "multiplication_operators",
    "orientation_operators",
    "orthonormality_error",
    "precise_map_of",
    "read_asset",
    "read_point_cloud",
    "read_surface",
    "set_threads",
    "shot",
    "slanted_sizes",
    "store_shapes",
    "transfer",
    "transfer_asset",
    "transfer_asset_steps",
    "vertex_map_of",
    "wave_kernel_map",
    "wave_kernel_signature",
    "wrap",
    "wrap_steps",
    "write_asset",
    "zoomout",
    "zoomout_both_ways",
]


def __getattr__(name: str) -> str:
    """`__version__`, read when it is asked for."""
    if name == "__version__":
        from importlib.metadata import version

        return version("zoomout-core")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
