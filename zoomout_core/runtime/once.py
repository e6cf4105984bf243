# SPDX-License-Identifier: GPL-3.0-or-later
"""Values that are computed once for an object, and cached with it.

Threads that need the same value at the same time may each compute it, but all get the first result.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, Concatenate, ParamSpec, TypeVar, cast

Argument = TypeVar("Argument")
Further = ParamSpec("Further")
Result = TypeVar("Result")


if TYPE_CHECKING:
    from functools import cached_property as cached_property  # explicitly, so that other modules may import it
else:

    class cached_property(functools.cached_property):  # noqa: N801 - named like the one that it replaces
        """A cached property that several objects compute at the same time.

        Before Python 3.12, the one of `functools` has a lock for all objects of a class, so their threads wait for each
        other.
        """

        def __get__(self, instance, owner=None):
            if instance is None:
                return self
            if self.attrname not in instance.__dict__:
                instance.__dict__.setdefault(self.attrname, self.func(instance))
            return instance.__dict__[self.attrname]


def once_per_argument(
    function: Callable[Concatenate[Argument, Further], Result],
) -> Callable[Concatenate[Argument, Further], Result]:
    """Cache the results of a function of an object with the object, like a cached property.

    So a module can extend a class of a lower layer, which need not know of it. Each combination of further arguments,
    such as a number, has its own result.
    """
    name = f"{function.__module__}.{function.__qualname__}"

    @wraps(function)
    def wrapper(argument: Argument, /, *further: Further.args, **named: Further.kwargs) -> Result:
        key = " ".join([name, *map(repr, further), *map(repr, named.items())])
        if key not in argument.__dict__:
            argument.__dict__.setdefault(key, function(argument, *further, **named))
        return cast(Result, argument.__dict__[key])

    return wrapper
