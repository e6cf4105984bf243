# SPDX-License-Identifier: GPL-3.0-or-later
"""MeshLab's filter scripts (`.mlx`), with this project's filters among MeshLab's own.

A script is a list of filters with their parameters in XML. Scripts saved by the desktop program name filters as its
menus do ("Simplification: Quadric Edge Collapse Decimation"); pymeshlab runs these one at a time. Filters may also
have pymeshlab's names. The whole script is parsed and checked before the first filter runs, except for the names from
menus, which only pymeshlab can check when it runs a filter.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

import meshlab_filter.filters  # noqa: F401, which enters them into the catalogue
from meshlab_filter.catalogue import CATALOGUE, Filter, apply_filter, check_counts_of, check_mesh, filter_list
from meshlab_filter.parameters import LENGTH, OTHER_RICH, RICH_TYPES, Parameter, absolute_length, diagonal
from meshlab_filter.xml_elements import Element, read_elements
from zoomout_core.arrays import Floats
from zoomout_core.mesh.errors import MeshError
from zoomout_core.messages import message_of
from zoomout_core.runtime.progress import stage

if TYPE_CHECKING:
    from pymeshlab import MeshSet

# pymeshlab's message for an unknown filter.
UNKNOWN = "Something really bad happened"
# The form of filters' names in Python; names in the menus have capitals and spaces.
SNAKE_CASE = re.compile("[a-z0-9]+(_[a-z0-9]+)+")


@dataclass(frozen=True, eq=False)
class Call:
    """A call of a filter in a script.

    Attributes:
        element: its element in the script.
        values: values of the parameters by name, parsed; those of filters from the menus are the script's texts.
        meshes: the values that are mesh ids.
    """

    element: Element
    values: dict[str, Any]
    meshes: tuple[int, ...]

    @property
    def name(self) -> str:
        """The filter's name."""
        return self.element.attributes["name"]


def read_script(path: str | Path) -> list[Call]:
    """Parse the calls of a script, in order.

    Raises:
        MeshError: it is not a script, or a call of this project's filters is wrong; the message names the line.
        OSError: the file cannot be read.
    """
    root = read_elements(path, "FilterScript", ".mlx")
    return [_call(path, element) for element in root.inside]


def run_script(ms: MeshSet, path: str | Path) -> list[dict[str, Any]]:
    """Run a script on a MeshSet, and return each filter's results with its `name` and `line`.

    Raises:
        MeshError: the script is wrong, or a filter cannot be applied; the message names the line. Filters before it
            have been applied.
        OSError: the file cannot be read.
    """
    calls = read_script(path)
    reports = []
    for number, call in enumerate(calls):
        with stage(call.name, number / len(calls), (number + 1) / len(calls)):
            report = _at_line(path, call.element, _apply, ms, call)
        reports.append({"name": call.name, "line": call.element.line, **report})
    return reports


def _at_line(path: str | Path, element: Element, function: Any, *arguments: Any) -> Any:
    """Call a function, and add the element's line to its error messages."""
    try:
        return function(*arguments)
    except (ValueError, OSError) as error:
        raise MeshError(f"Line {element.line} of {path}: {message_of(error)}") from error


def _call(path: str | Path, element: Element) -> Call:
    _at_line(path, element, _check_filter, element)
    row = CATALOGUE.get(element.attributes["name"])
    read = [_at_line(path, child, _value, child, row) for child in element.inside]
    meshes = [
        value for child, (_, value) in zip(element.inside, read, strict=True) if child.attributes["type"] == "RichMesh"
    ]
    return Call(element, dict(read), tuple(meshes))


def _check_filter(element: Element) -> None:
    if element.tag != "filter":
        raise MeshError(f"expected a filter, but found a {element.tag}: save the script with MeshLab 2022 or later.")
    if not element.attributes.get("name"):
        raise MeshError("the filter has no name: give one.")
    name = element.attributes["name"]
    if SNAKE_CASE.fullmatch(name) and name not in (known := filter_list()):
        like = get_close_matches(name, known, n=1)
        remedy = f"is '{like[0]}' meant?" if like else "call filter_list() for their names."
        raise MeshError(f"there is no filter '{name}': {remedy}")


def _value(child: Element, row: Filter | None) -> tuple[str, Any]:
    """The name and the value of a parameter."""
    missing = [name for name in ("name", "type", "value") if name not in child.attributes]
    name, rich = child.attributes.get("name", ""), child.attributes.get("type", "")
    if child.tag != "Param":
        raise MeshError(f"expected a Param, but found a {child.tag}: correct it.")
    if rich in OTHER_RICH and row is None:
        return name, None  # several XML attributes form the value, and pymeshlab parses them
    if missing:
        raise MeshError(f"the parameter '{name}' has no {' or '.join(missing)}: give it.")
    if rich not in RICH_TYPES:
        raise MeshError(f"'{name}' has the unknown type {rich}: use one of {', '.join(RICH_TYPES)}.")
    if row is None:
        return name, Parameter(name, RICH_TYPES[rich], None, "").read(child.attributes["value"])
    for parameter in row.parameters:
        if parameter.name == name:
            if rich not in parameter.type.rich:
                raise MeshError(f"'{name}' has the type {rich}: give it as {' or '.join(parameter.type.rich)}.")
            return name, parameter.read(child.attributes["value"])
    known = ", ".join(parameter.name for parameter in row.parameters)
    raise MeshError(f"the filter {row.name} has no parameter '{name}': it has {known}.")


def _apply(ms: MeshSet, call: Call) -> dict[str, Any]:
    """Apply the filter of a call, after checking that its meshes exist."""
    for mesh_id in call.meshes:
        check_mesh(ms, mesh_id)
    if call.name in CATALOGUE:
        return CATALOGUE[call.name].run(ms, **call.values)
    return _apply_native(ms, call)


def _apply_native(ms: MeshSet, call: Call) -> dict[str, Any]:
    """Apply a filter of MeshLab's."""
    import pymeshlab

    if ms.mesh_number() == 0:  # otherwise pymeshlab would end the process
        raise MeshError("there is no mesh left to apply a filter to: keep at least one.")
    if call.name in pymeshlab.filter_list():
        if None in call.values.values():
            raise MeshError(
                f"'{call.name}' has a parameter that is only read if the filter has its name from MeshLab's menus."
            )
        return apply_filter(ms, call.name, **call.values)
    check_counts_of(call.name, call.values)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "filter.mlx"
        path.write_text(_script_of(call, ms.current_mesh().vertex_matrix()), encoding="utf-8")
        ms.load_filter_script(str(path))
    try:
        ms.apply_filter_script()
    except (pymeshlab.PyMeshLabException, RuntimeError) as error:
        reason = " ".join(str(error).split())
        if reason.startswith(UNKNOWN):
            raise MeshError(f"there is no filter '{call.name}' in MeshLab or this project: check the name.") from error
        raise MeshError(
            f"MeshLab could not apply '{call.name}' ({reason}): check its parameters and the mesh."
        ) from error
    finally:
        ms.clear_filter_script()
    return {}


def _script_of(call: Call, vertices: Floats) -> str:
    """A script of one filter taken from a longer one; lengths in percent refer to a mesh (n, 3)."""
    lines = ["<!DOCTYPE FilterScript>", "<FilterScript>", f"<filter {_attributes(call.element.attributes)}>"]
    for child in call.element.inside:
        attributes = child.attributes
        if attributes["type"] in LENGTH.rich:
            # Without both bounds, which hand-written scripts omit, MeshLab reads another value.
            length = absolute_length(call.values[attributes["name"]], vertices)
            bounds = {"min": "0", "max": repr(max(length, diagonal(vertices)))}
            attributes = {**bounds, **attributes, "value": repr(length)}
        lines.append(f"<Param {_attributes(attributes)}/>")
    return "\n".join([*lines, "</filter>", "</FilterScript>"])


def _attributes(attributes: dict[str, str]) -> str:
    # Control characters, such as the line breaks in tooltips, are stored as numeric references.
    pairs = (f"{name}={quoteattr(value)}" for name, value in attributes.items())
    return re.sub(r"[\n\r\t]", lambda found: f"&#{ord(found[0])};", " ".join(pairs))
