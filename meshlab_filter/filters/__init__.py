# SPDX-License-Identifier: GPL-3.0-or-later
"""The filters, which are added to the catalogue when their modules are imported."""

from meshlab_filter.filters.correspondence import (
    apply_conform_by_zoomout,
    compute_color_by_correspondence,
    compute_correspondence_by_zoomout,
    compute_scalar_by_correspondence_error,
)
from meshlab_filter.filters.spectrum import compute_laplacian_eigenfunctions
from meshlab_filter.filters.symmetry import compute_symmetry_by_zoomout
from meshlab_filter.filters.texture import transfer_texture_by_zoomout
from meshlab_filter.filters.transfer import transfer_attributes_by_zoomout

__all__ = [
    "apply_conform_by_zoomout",
    "compute_color_by_correspondence",
    "compute_correspondence_by_zoomout",
    "compute_laplacian_eigenfunctions",
    "compute_scalar_by_correspondence_error",
    "compute_symmetry_by_zoomout",
    "transfer_attributes_by_zoomout",
    "transfer_texture_by_zoomout",
]
