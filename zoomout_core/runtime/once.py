# SPDX-License-Identifier: GPL-3.0-or-later
"""Values that are computed once for an object, and cached with it."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import TypeVar, cast

Argument = TypeVar("Argument")
Result = TypeVar("Result")


def once_per_argument(function: Callable[[Argument], Result]) -> Callable[[Argument], Result]:
    """Keep what a function of an object returns with the object, as a cached property does.

    So a module adds to a class of a lower one what that one need not know.
    """
    name = f"{function.__module__}.{function.__qualname__}"

    @wraps(function)
    def wrapper(argument: Argument) -> Result:
        if name not in argument.__dict__:
            argument.__dict__[name] = function(argument)
        return cast(Result, argument.__dict__[name])

    return wrapper
