"""Dense correspondence between surfaces by spectral upsampling (ZoomOut), and attribute transfer with it."""

from zoomout_core.correspondence.functional_map import commutativity_error, orthonormality_error
from zoomout_core.correspondence.kept_shapes import forget_shapes, store_shapes
from zoomout_core.correspondence.matching import MatchResult, match, match_steps
from zoomout_core.correspondence.proximity import ProximityMatch, match_by_proximity, match_by_proximity_steps
from zoomout_core.correspondence.surface_map import SurfaceMap
from zoomout_core.correspondence.zoomout import zoomout
from zoomout_core.evaluation import geodesic_error
from zoomout_core.files import read_point_cloud, read_surface
from zoomout_core.progress import Progress, drain
from zoomout_core.spectral.eigenbasis import SpectralBasis, eigenbasis
from zoomout_core.surface import MeshError, PointCloud, Surface
from zoomout_core.symmetry.detect import Symmetry, detect_symmetry, detect_symmetry_steps
from zoomout_core.threads import set_threads
from zoomout_core.transfer import Attribute, Domain, Kind, conform, transfer

__all__ = [
    "Attribute",
    "Domain",
    "Kind",
    "MatchResult",
    "MeshError",
    "PointCloud",
    "Progress",
    "ProximityMatch",
    "SpectralBasis",
    "Surface",
    "SurfaceMap",
    "Symmetry",
    "commutativity_error",
    "conform",
    "detect_symmetry",
    "detect_symmetry_steps",
    "drain",
    "eigenbasis",
    "forget_shapes",
    "geodesic_error",
    "match",
    "match_by_proximity",
    "match_by_proximity_steps",
    "match_steps",
    "orthonormality_error",
    "read_point_cloud",
    "read_surface",
    "set_threads",
    "store_shapes",
    "transfer",
    "zoomout",
]
