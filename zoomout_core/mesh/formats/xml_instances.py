# SPDX-License-Identifier: GPL-3.0-or-later
"""Count the instances of meshes in COLLADA and 3MF files before these are read."""

from __future__ import annotations

from collections import defaultdict
from graphlib import CycleError, TopologicalSorter
from xml.parsers.expat import ExpatError, ParserCreate

from zoomout_core.runtime.input_files import FormatError

# Instances that a file may have, if its own nodes and objects are fewer.
MAX_INSTANCES = 10_000
# Elements that contain instances, and the attribute by which each instance names another element.
CONTAINERS = frozenset({"node", "visual_scene", "object", "build"})
NAMED_BY = {"instance_node": "url", "component": "objectid", "item": "objectid"}


class InstancesError(FormatError):
    """Instances that are endless or too many; the message is a part of a sentence."""


def check_instances(content: bytes) -> None:
    """Check the instances in an XML file; one that is damaged is left to its reader.

    Raises:
        InstancesError: an element contains itself, or there are more than `MAX_INSTANCES`.
    """
    inside: dict[str, list[str]] = defaultdict(list)
    above: list[str] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        name = tag.rpartition(":")[2]
        if name in CONTAINERS:
            number = attributes.get("id", f"element {len(inside)}")
            if above:
                inside[above[-1]].append(number)
            above.append(number)
            inside[number] += []
        elif name in NAMED_BY and above:
            inside[above[-1]].append(attributes.get(NAMED_BY[name], "").removeprefix("#"))

    def end(tag: str) -> None:
        if tag.rpartition(":")[2] in CONTAINERS:
            above.pop()

    parser = ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    try:
        parser.Parse(content, True)
        order = list(TopologicalSorter(inside).static_order())
    except ExpatError:
        return
    except CycleError:
        raise InstancesError("one of its objects is an instance of itself") from None
    count: dict[str, int] = {}
    for each in order:
        count[each] = 1 + sum(count[other] for other in inside.get(each, ()))
    most = max(MAX_INSTANCES, len(inside))
    if max(count.values(), default=0) > most:
        raise InstancesError(f"it has more than {most} instances")
