# SPDX-License-Identifier: GPL-3.0-or-later
"""Values that are computed once for an object, and cached with it."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import TypeVar, cast

Argument = TypeVar("Argument")
Result = TypeVar("Result")


def once_per_argument(function: Callable[[Argument], Result]) -> Callable[[Argument], Result]:
    """Cache the result of a function of an object with the object, like a cached property.

    So a module can extend a class of a lower layer, which need not know of it.
    """
    name = f"{function.__module__}.{function.__qualname__}"

    @wraps(function)
    def wrapper(argument: Argument) -> Result:
        if name not in argument.__dict__:
            argument.__dict__[name] = function(argument)
        return cast(Result, argument.__dict__[name])

    return wrapper
