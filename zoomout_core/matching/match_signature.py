# SPDX-License-Identifier: GPL-3.0-or-later
"""The signature of `match`, made from `MatchOptions`, so that each option is declared once."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields
from inspect import Parameter, signature
from typing import ParamSpec, Protocol, cast, overload

from zoomout_core.matching.options import MatchOptions
from zoomout_core.matching.presets import DETAIL, sizes_in_words
from zoomout_core.matching.result import MatchResult
from zoomout_core.mesh.shapes import ShapeLike
from zoomout_core.runtime.option_names import check_option_names
from zoomout_core.runtime.progress import Progress

Arguments = ParamSpec("Arguments")

# The line in the docstring of `match` that is replaced by the options.
GIVEN = "        given: options as keyword arguments; they override `options`.\n"


@dataclass(frozen=True, eq=False, kw_only=True)
class MatchArguments(MatchOptions):
    """The keyword arguments of `match`: the fields of `MatchOptions`, and those that are not options of the map."""

    options: MatchOptions | None = None
    progress: Callable[[Progress], object] | None = None


def check_names(given: Iterable[str]) -> None:
    """Check that the options of a user exist.

    Raises:
        TypeError: one does not; the message names the most similar one.
    """
    known = [field.name for field in fields(MatchOptions)]
    given = tuple(given)
    for name in given:
        if name == "detail":
            sizes = "; ".join(f"{word}: {sizes_in_words(word)}" for word in DETAIL)
            raise TypeError(f"match has no option detail: give its sizes, such as k_final=200 ({sizes}).")
    check_option_names("match", given, known)


class MatchFunction(Protocol[Arguments]):
    """The signature of `match`, from the fields of `MatchArguments`, so that type checkers know the options."""

    @overload
    def __call__(
        self, source: ShapeLike, target: ShapeLike, *args: Arguments.args, **kwargs: Arguments.kwargs
    ) -> MatchResult: ...

    @overload
    def __call__(
        self,
        source: ShapeLike,
        target: ShapeLike,
        options: MatchOptions | None,
        /,
        *args: Arguments.args,
        **kwargs: Arguments.kwargs,
    ) -> MatchResult: ...


def options_help() -> str:
    """The description of the options, from that of `MatchOptions`, in the form of a function's arguments."""
    text = (MatchOptions.__doc__ or "").partition("Attributes:\n")[2].partition("\n\n")[0]
    return f"{text}\n"


def with_arguments(
    arguments: Callable[Arguments, MatchArguments],
) -> Callable[[Callable[..., MatchResult]], MatchFunction[Arguments]]:
    """Give `match` the signature of its arguments, and their descriptions, for type checkers and for `help`."""

    def add_signature(function: Callable[..., MatchResult]) -> MatchFunction[Arguments]:
        known = [each for each in signature(function).parameters.values() if each.kind is not Parameter.VAR_KEYWORD]
        options = signature(MatchOptions).parameters.values()
        function.__doc__ = (function.__doc__ or "").replace(GIVEN, options_help())
        function.__signature__ = signature(function).replace(parameters=[*known, *options])  # type: ignore[attr-defined]
        return cast("MatchFunction[Arguments]", function)

    return add_signature
