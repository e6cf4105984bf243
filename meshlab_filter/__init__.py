# SPDX-License-Identifier: GPL-3.0-or-later
"""Filters for pymeshlab that transfer data between layers with different poses and topologies.

    import pymeshlab
    import meshlab_filter

    ms = pymeshlab.MeshSet()
    ms.load_new_mesh("character.obj")    # mesh 0, with textures
    ms.load_new_mesh("retopology.ply")   # mesh 1, in another pose
    meshlab_filter.transfer_attributes_by_zoomout(ms, sourcemesh=0, targetmesh=1)
    ms.save_current_mesh("result.obj")

`print_filter_list()` describes the filters, `search(words)` searches these and MeshLab's own,
`print_filter_parameter_list(name)` lists the parameters of one, and `apply_filter(ms, name)` applies it.
`python -m meshlab_filter` does the same for files and `.mlx` scripts.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from meshlab_filter.catalogue import (
        apply_filter,
        filter_list,
        print_filter_list,
        print_filter_parameter_list,
        search,
    )
    from meshlab_filter.filters import (
        apply_conform_by_zoomout,
        compute_color_by_correspondence,
        compute_correspondence_by_zoomout,
        compute_laplacian_eigenfunctions,
        compute_scalar_by_correspondence_error,
        compute_symmetry_by_zoomout,
        transfer_attributes_by_zoomout,
        transfer_texture_by_zoomout,
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
    "print_filter_list",
    "print_filter_parameter_list",
    "search",
    "transfer_attributes_by_zoomout",
    "transfer_texture_by_zoomout",
]

if not TYPE_CHECKING:  # type checkers report wrong names

    def __getattr__(name: str) -> object:
        """Import a public name on first use, so that an early interrupt of the command line shows no traceback."""
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        filters = import_module(f"{__name__}.filters")  # the import adds the filters to the catalogue
        home = filters if hasattr(filters, name) else import_module(f"{__name__}.catalogue")
        value = globals()[name] = getattr(home, name)
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
