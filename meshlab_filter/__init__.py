"""Filters for pymeshlab, between layers in different poses, or of different triangles.

    import pymeshlab
    import meshlab_filter

    ms = pymeshlab.MeshSet()
    ms.load_new_mesh("character.obj")    # mesh 0, with textures
    ms.load_new_mesh("retopology.ply")   # mesh 1, in another pose
    meshlab_filter.transfer_attributes_by_zoomout(ms, sourcemesh=0, targetmesh=1)
    ms.save_current_mesh("result.obj")

`filter_list()` names the filters, `print_filter_parameter_list(name)` what they take, and `apply_filter(ms, name)`
applies these and MeshLab's own. `python -m meshlab_filter` does the same for files and `.mlx` scripts.
"""

from meshlab_filter.catalogue import apply_filter, filter_list, print_filter_parameter_list
from meshlab_filter.filters import (
    apply_conform_by_zoomout,
    compute_color_by_correspondence,
    compute_correspondence_by_zoomout,
    compute_laplacian_eigenfunctions,
    compute_scalar_by_correspondence_error,
    compute_symmetry_by_zoomout,
    transfer_attributes_by_zoomout,
)

__all__ = [
    "apply_conform_by_zoomout",
    "apply_filter",
    "compute_color_by_correspondence",
    "compute_correspondence_by_zoomout",
    "compute_laplacian_eigenfunctions",
    "compute_scalar_by_correspondence_error",
    "compute_symmetry_by_zoomout",
    "filter_list",
    "print_filter_parameter_list",
    "transfer_attributes_by_zoomout",
]
