# SPDX-License-Identifier: GPL-3.0-or-later
"""MeshLab's XML files, scripts and projects, as trees of elements with line numbers.

Entities are refused, so that no file expands beyond its size or includes another file.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers.expat import ErrorString, ExpatError, ParserCreate

from zoomout_core.mesh.errors import MeshError
from zoomout_core.runtime.input_files import read_whole


@dataclass(eq=False)
class Element:
    """An XML element.

    Attributes:
        tag: its name.
        line: number of its first line, from 1.
        attributes: by name.
        inside: its child elements.
        text: its text, without that of child elements.
    """

    tag: str
    line: int
    attributes: dict[str, str]
    inside: list[Element] = field(default_factory=list)
    text: str = ""

    def find(self, tag: str) -> list[Element]:
        """The child elements with a name."""
        return [each for each in self.inside if each.tag == tag]


def read_elements(path: str | Path, root: str, ending: str) -> Element:
    """Parse an XML file.

    Args:
        path: the file.
        root: the required name of its root element.
        ending: the extension of such files, for messages.

    Raises:
        MeshError: it is not XML, declares entities, or has another root; the message names the line.
        OSError: the file cannot be read.
    """
    parser, opened, outermost = ParserCreate(), list[Element](), list[Element]()

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, parser.CurrentLineNumber, attributes)
        (opened[-1].inside if opened else outermost).append(element)
        opened.append(element)

    def refuse(name: str, *_: object) -> None:
        raise MeshError(f"Line {parser.CurrentLineNumber} of {path} declares the entity {name}: remove it.")

    def text(characters: str) -> None:
        opened[-1].text += characters

    parser.buffer_text = True
    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: opened.pop()
    parser.CharacterDataHandler = text
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(read_whole(path), True)
    except ExpatError as error:
        raise MeshError(f"Line {error.lineno} of {path} is not valid XML: {ErrorString(error.code)}.") from None
    (found,) = outermost
    if found.tag != root:
        raise MeshError(f"Line {found.line} of {path} has a {found.tag} instead of a {root}: give a {ending} file.")
    return found
