"""What the operators have in common that work along a symmetry kept on the active mesh."""

from __future__ import annotations

from bpy.types import Context, Object

import zoomout_core as zo

from ... import stored_symmetry
from ...pair import check_writable, find_mesh
from ..stepped import SteppedOperator


class SymmetryOperator(SteppedOperator):
    """The base of operators that need the symmetry of the active mesh."""

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether the active object is a mesh whose symmetry is known."""
        if not super().poll(context):
            return False
        if stored_symmetry.PROPERTY not in context.active_object.data:
            cls.poll_message_set("Detect the symmetry of this mesh first")
            return False
        return True


def writable_mesh(context: Context, name: str) -> Object:
    """The mesh object of a name, ready to be read and written.

    Raises:
        MeshError: there is none, it is being edited, or it belongs to another file.
    """
    obj = find_mesh(context, name)
    check_writable(obj)
    return obj


def unedited(context: Context, name: str, before: zo.Surface) -> Object:
    """The object of a name, whose mesh is still what it was when it was read.

    Raises:
        MeshError: it was removed or edited since.
    """
    obj = writable_mesh(context, name)
    now = stored_symmetry.rest_surface(obj)
    if stored_symmetry.fingerprint_of(now) != stored_symmetry.fingerprint_of(before):
        raise zo.MeshError(f"'{name}' was edited while it was being worked on: start again.")
    return obj
