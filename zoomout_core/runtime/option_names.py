# SPDX-License-Identifier: GPL-3.0-or-later
"""Reject unknown options of public functions in a sentence that suggests the most similar known one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from functools import wraps
from inspect import signature
from typing import ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Returned = TypeVar("Returned")


def check_option_names(function: str, given: Iterable[str], known: Sequence[str]) -> None:
    """Check that the options that a user gave to a function exist.

    Raises:
        TypeError: one does not; the message names the most similar one.
    """
    for name in given:
        if name not in known:
            near = get_close_matches(name, known, 1)
            hint = f"did you mean {near[0]}?" if near else f"choose from {', '.join(known)}."
            raise TypeError(f"{function} has no option {name}: {hint}")


def suggest_names(function: Callable[Arguments, Returned]) -> Callable[Arguments, Returned]:
    """Make a function reject an unknown keyword argument with a TypeError that suggests the most similar one."""
    known = list(signature(function).parameters)

    @wraps(function)
    def wrapper(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Returned:
        check_option_names(function.__name__, kwargs, known)
        return function(*args, **kwargs)

    return wrapper
