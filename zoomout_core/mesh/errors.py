# SPDX-License-Identifier: GPL-3.0-or-later
"""The error of meshes and files that cannot be used."""

from __future__ import annotations

from zoomout_core.messages import as_message, message


class MeshError(ValueError):
    """A mesh that cannot be used; the message names the fault and a remedy, in one sentence.

    Args:
        text: the sentence, or a template with named fields, see `messages.message`.
        values: values of these fields.

    Example:
        >>> zo.Surface([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])
        Traceback (most recent call last):
        zoomout_core.mesh.errors.MeshError: The mesh has no area because all of its faces are degenerate: repair them.
    """

    def __init__(self, text: str = "", **values: object) -> None:
        super().__init__(message(text, **values) if values else as_message(text))
