# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading and writing the mesh of one object, with checks for edits in between."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from bpy.types import Context, Mesh, Object

import zoomout_core as zo

from ...mesh_data import all_or_nothing
from ...scene.pair import check_elements, check_writable, edit_error, find_mesh
from ...storage import stored_symmetry

# Fraction of the progress that reading data takes.
READ = 0.3
READING = "Reading the mesh"


def writable_mesh(context: Context, name: str) -> Object:
    """The mesh object of a name, ready to read and write.

    Raises:
        MeshError: there is no such mesh, it is in Edit Mode, or it belongs to another file.
    """
    obj = find_mesh(context, name)
    check_writable(obj)
    return obj


@contextmanager
def own_mesh(context: Context, name: str, surface: zo.Surface) -> Iterator[tuple[Object, Mesh]]:
    """The object of a name and its mesh, to read data besides its surface.

    Raises:
        MeshError: it was removed, or its number of elements has changed since the surface was read.
    """
    obj = writable_mesh(context, name)
    check_elements(name, surface, obj.data)
    yield obj, obj.data


@contextmanager
def writing(context: Context, name: str, before: zo.Surface) -> Iterator[Object]:
    """`find_not_edited`, and a context for writing to the object, all or nothing."""
    obj = find_not_edited(context, name, before)
    with all_or_nothing(obj):
        yield obj


def find_not_edited(context: Context, name: str, before: zo.Surface) -> Object:
    """The object of a name, after checking that its mesh was not edited since it was read.

    Raises:
        MeshError: it was removed or edited since.
    """
    obj = writable_mesh(context, name)
    if stored_symmetry.fingerprint(obj) != stored_symmetry.fingerprint_of(before):
        raise edit_error(name)
    return obj
