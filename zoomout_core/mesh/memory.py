# SPDX-License-Identifier: GPL-3.0-or-later
"""Report a lack of memory in a sentence."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar, cast

from zoomout_core.mesh.errors import MeshError
from zoomout_core.messages import NO_MEMORY


class NotEnoughMemoryError(MeshError):
    """A mesh that is too large for the memory available now; later, or on another machine, there may be more."""


Function = TypeVar("Function", bound=Callable[..., Any])


def memory_in_words(function: Function) -> Function:
    """Make a function raise `NotEnoughMemoryError`, which says what to do, if memory runs out."""

    @wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        try:
            return function(*args, **kwargs)
        except MemoryError:
            raise NotEnoughMemoryError(NO_MEMORY) from None

    return cast(Function, wrapper)
