# SPDX-License-Identifier: GPL-3.0-or-later
"""The catalogue of filters, with one row each, and functions that take a filter's name.

A filter is a function that takes a MeshSet and keyword parameters, and returns a dictionary; `mesh_filter` adds it
to the catalogue. Values are checked and defaults filled in before it is called. It computes first and changes the
MeshSet last.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from inspect import Parameter as SignatureParameter
from inspect import Signature
from numbers import Integral
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from meshlab_filter.parameters import LENGTH, Parameter
from zoomout_core.mesh.errors import MeshError
from zoomout_core.runtime.progress import advance, listening, stage

if TYPE_CHECKING:
    from pymeshlab import MeshSet

# Called with the fraction done, in [0, 1], and the name of the stage.
Callback: TypeAlias = Callable[[float, str], object]


@dataclass(frozen=True)
class Filter:
    """A row of the catalogue.

    Attributes:
        name: its name in Python and in scripts.
        function: its implementation.
        parameters: its parameters, in the order in which they are listed.
        meaning: its description, one sentence.
    """

    name: str
    function: Callable[..., dict[str, Any]]
    parameters: tuple[Parameter, ...]
    meaning: str

    def run(self, ms: MeshSet, **given: Any) -> dict[str, Any]:
        """Apply the filter with the given parameters and the defaults of all others.

        Raises:
            ValueError: a parameter does not exist, or a value has the wrong type; nothing has been computed.
            MeshError: source and target are the same mesh.
        """
        values = self._complete(given)
        source, target = (values.get(name) for name in PAIR)
        if source is not None and source == target:
            raise MeshError(f"A mesh cannot be its own source: give another id than {target} for one of the two.")
        return self.function(ms, **values)

    def _complete(self, given: dict[str, Any]) -> dict[str, Any]:
        rows = {row.name: row for row in self.parameters}
        for name in given:
            if name not in rows:
                raise ValueError(f"The filter {self.name} has no parameter '{name}': it has {', '.join(rows)}.")
        try:
            return {name: row.check(given.get(name, _default(row))) for name, row in rows.items()}
        except ValueError as error:
            raise ValueError(f"The filter {self.name}: {error}") from None


CATALOGUE: dict[str, Filter] = {}
# The parameters of filters that take two meshes.
PAIR = ("sourcemesh", "targetmesh")
# Number of ids of meshes that a sentence lists.
LISTED = 8
CALLBACK = (
    "Called with the fraction completed and the name of the stage; raising an exception in it cancels the filter "
    "without changes."
)


class MeshFilter(Protocol):
    """A filter as a function; `row` is its row of the catalogue."""

    row: Filter

    def __call__(self, ms: MeshSet, *, callback: Callback | None = None, **parameters: Any) -> dict[str, Any]: ...


def mesh_filter(*parameters: Parameter) -> Callable[[Callable[..., dict[str, Any]]], MeshFilter]:
    """A decorator that adds a function to the catalogue under its own name.

    The function takes all parameters by keyword; the first line of its docstring is its description. The decorated
    function takes any of them, and a callback for progress.
    """

    def register(function: Callable[..., dict[str, Any]]) -> MeshFilter:
        description = function.__doc__ or ""
        row = Filter(function.__name__, function, parameters, description.partition("\n")[0])
        CATALOGUE[row.name] = row

        def run(ms: MeshSet, *, callback: Callback | None = None, **given: Any) -> dict[str, Any]:
            _check_mesh_set(ms)
            with _listening(callback):
                return row.run(ms, **given)

        run.__name__ = run.__qualname__ = row.name
        run.__module__ = function.__module__
        lines = [f"        {parameter.name}: {parameter.meaning}" for parameter in parameters]
        lines.append(f"        callback: {CALLBACK}")
        run.__doc__ = "\n".join([description.rstrip(), "", "    Args:", "        ms: a `pymeshlab.MeshSet`.", *lines])
        given = [
            SignatureParameter(parameter.name, SignatureParameter.KEYWORD_ONLY, default=parameter.default)
            for parameter in parameters
        ]
        ms = SignatureParameter("ms", SignatureParameter.POSITIONAL_OR_KEYWORD)
        callback = SignatureParameter("callback", SignatureParameter.KEYWORD_ONLY, default=None)
        run.__signature__ = Signature([ms, *given, callback])  # type: ignore[attr-defined]
        run.row = row  # type: ignore[attr-defined]
        return run  # type: ignore[return-value]

    return register


def filter_list() -> list[str]:
    """The names of all filters that `apply_filter` accepts: this project's, then MeshLab's."""
    import pymeshlab

    return [*CATALOGUE, *pymeshlab.filter_list()]


def search(words: str) -> list[str]:
    """The names of the filters that contain all given words; this project's descriptions are searched as well.

    Args:
        words: words or parts of words, separated by spaces; case is ignored.
    """
    wanted = re.split(r"[\s_]+", words.strip().lower())
    return [name for name in filter_list() if all(word in _help_text(name).lower() for word in wanted)]


def meaning(name: str) -> str:
    """A sentence that describes a filter of this project; empty for MeshLab's, which pymeshlab does not describe."""
    return CATALOGUE[name].meaning if name in CATALOGUE else ""


def _help_text(name: str) -> str:
    """The searchable text of a filter."""
    parameters = CATALOGUE[name].parameters if name in CATALOGUE else ()
    return " ".join([name, meaning(name), *(f"{parameter.name} {parameter.meaning}" for parameter in parameters)])


def print_filter_list(words: str = "") -> None:
    """Print the filters that contain all given words, one on each line; without words, this project's filters."""
    for name in search(words) if words else CATALOGUE:
        print(f"{name}: {meaning(name)}" if meaning(name) else name)


def print_filter_parameter_list(name: str) -> None:
    """Print a filter's parameters with descriptions, one on each line, like `pymeshlab.print_filter_parameter_list`.

    Raises:
        MeshError: there is no such filter.
    """
    import pymeshlab

    _check_name(name)
    if name not in CATALOGUE:
        pymeshlab.print_filter_parameter_list(name)
        return
    print(f"{name} filter - list of parameter names:")
    for parameter in CATALOGUE[name].parameters:
        default = f"{parameter.default}%" if parameter.type is LENGTH else repr(parameter.default)
        of = f" ({parameter.wanted})" if parameter.choices else ""
        print(f"\t{parameter.name} : {parameter.type.label} = {default}\n\t\t{parameter.meaning}{of}")


def apply_filter(ms: MeshSet, name: str, /, *, callback: Callback | None = None, **parameters: Any) -> dict[str, Any]:
    """Apply a filter of this project or of MeshLab by its name.

    Args:
        ms: a `pymeshlab.MeshSet`.
        name: one of `filter_list()`.
        callback: called with the fraction done, in [0, 1], and the name of the stage; an exception that it raises ends
            the work. MeshLab's own filters call it at the beginning and at the end.
        parameters: the filter's parameters, which `print_filter_parameter_list` lists.

    Returns:
        The filter's results, by name.

    Raises:
        MeshError: the filter or the mesh does not exist, or the filter cannot be applied to the mesh.
        ValueError: a parameter does not exist, or its value has the wrong type.
    """
    _check_name(name)
    _check_mesh_set(ms)
    with _listening(callback):
        if name in CATALOGUE:
            return CATALOGUE[name].run(ms, **parameters)
        with stage(name):
            report = _apply_native(ms, name, parameters)
            advance(1.0)
            return report


def _check_mesh_set(ms: object) -> None:
    """Raise a TypeError unless a script gave a MeshSet."""
    from pymeshlab import MeshSet

    if not isinstance(ms, MeshSet):
        raise TypeError(f"The meshes are a {type(ms).__name__}: give a pymeshlab.MeshSet.")


def check_mesh(ms: MeshSet, mesh_id: int) -> None:
    """Check that a mesh id exists; MeshLab's own filters would end the process otherwise.

    Raises:
        MeshError: there is none.
    """
    if not ms.mesh_id_exists(mesh_id):
        raise MeshError(f"There is no mesh {mesh_id}: {_meshes_in_words(ms)}. Load it first, or give another id.")


def _meshes_in_words(ms: MeshSet) -> str:
    ids = [mesh.id() for mesh in ms]
    if len(ids) < 2:
        return f"the MeshSet has only mesh {ids[0]}" if ids else "the MeshSet is empty"
    listed = ids if len(ids) <= LISTED else [*ids[: LISTED - 1], "…", ids[-1]]
    return f"the MeshSet has the meshes {', '.join(map(str, listed))}"


def current_id(ms: MeshSet) -> int:
    """The id of the current mesh.

    Raises:
        MeshError: the MeshSet has none.
    """
    if ms.mesh_number() == 0:
        raise MeshError("The MeshSet is empty: load a mesh.")
    return int(ms.current_mesh_id())


def _check_name(name: str) -> None:
    if name not in filter_list():
        raise MeshError(f"There is no filter '{name}': call filter_list() for their names.")


def _listening(callback: Callback | None) -> AbstractContextManager[None]:
    """A context manager that reports progress to a callback, if there is one.

    Raises:
        TypeError: it cannot be called.
    """
    if not (callback is None or callable(callback)):
        raise TypeError(f"callback is {callback!r:.60}: give a function that takes a fraction and a text.")
    return listening(None if callback is None else lambda progress: callback(progress.fraction, progress.stage))


def check_counts_of(name: str, parameters: Mapping[str, Any]) -> None:
    """Raise a MeshError if a parameter of MeshLab's filter is a negative whole number.

    None of its filters has such a default, and some crash on one, which would end the process.
    """
    for parameter, value in parameters.items():
        if isinstance(value, Integral) and value < 0:
            raise MeshError(f"The filter {name}: '{parameter}' is {value}: give a whole number that is not negative.")


def _apply_native(ms: MeshSet, name: str, parameters: dict[str, Any]) -> dict[str, Any]:
    from pymeshlab import PyMeshLabException

    for parameter, value in parameters.items():
        if parameter.endswith("mesh") and isinstance(value, Integral) and not isinstance(value, bool):
            check_mesh(ms, int(value))
    check_counts_of(name, parameters)
    try:
        return dict(ms.apply_filter(name, **parameters) or {})
    except PyMeshLabException as error:
        raise MeshError(" ".join(str(error).split())) from error
    except RuntimeError as error:  # a value of a type that pymeshlab cannot convert
        raise ValueError(
            f"The filter {name} does not accept {parameters}: call print_filter_parameter_list for their types."
        ) from error


def _default(row: Parameter) -> Any:
    if row.type is not LENGTH:
        return row.default
    from pymeshlab import PercentageValue

    return PercentageValue(row.default)
