# SPDX-License-Identifier: GPL-3.0-or-later
"""A modifier, made of Blender's own nodes, that mixes a target's layers from those of its source at each evaluation.

The elements of the source that each element of the target reads, their weights, and which elements follow are
attributes of the target's mesh; other elements keep the values of that mesh. Each Sample Index and Store Named
Attribute evaluates its fields at all elements. So the values of the source, of which vertex groups are slow to read,
are captured once, and the attributes have the types that these nodes use.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
from bpy.types import GeometryNodeTree, Node, NodesModifier, NodeSocket, Object

import zoomout_core as zo
from zoomout_core.arrays import Booleans
from zoomout_core.transfer import Attribute, Domain, Kind
from zoomout_core.transfer.picks import Picks

from ..arrays import hash_of
from ..attributes.layers import LINK_ATTRIBUTES, Layer, Role, write_layer
from ..writing import remove_when_written

# The custom property that marks the node groups of links.
MARK = "zoomout_link"
# Distances between nodes in the editor.
COLUMN, ROW = 200, 400


@dataclass(frozen=True)
class NodeTypes:
    """The types of Blender's nodes for attributes of one type.

    Attributes:
        sampled: how values are read from the source and mixed.
        stored: how they are stored on the target.
    """

    sampled: str
    stored: str


# Types of attributes that nodes can mix and store in all supported versions of Blender.
NODE_TYPES = {
    "FLOAT": NodeTypes("FLOAT", "FLOAT"),
    "FLOAT2": NodeTypes("FLOAT_VECTOR", "FLOAT2"),
    "FLOAT_VECTOR": NodeTypes("FLOAT_VECTOR", "FLOAT_VECTOR"),
    "FLOAT_COLOR": NodeTypes("FLOAT_COLOR", "FLOAT_COLOR"),
    "BYTE_COLOR": NodeTypes("FLOAT_COLOR", "BYTE_COLOR"),
    "INT": NodeTypes("INT", "INT"),
    "INT8": NodeTypes("INT", "INT8"),
    "BOOLEAN": NodeTypes("BOOLEAN", "BOOLEAN"),
}

# Types of sockets by types of attributes.
SOCKETS = {"FLOAT": "FLOAT", "FLOAT_VECTOR": "VECTOR", "FLOAT_COLOR": "RGBA", "INT": "INT", "BOOLEAN": "BOOLEAN"}
# The attributes of picks, by the ends of their names.
PICKS = {
    **{f"_element_{number}": (Kind.LABEL, "INT") for number in range(3)},
    **{f"_weight_{number}": (Kind.SCALAR, "FLOAT") for number in range(3)},
    "_follows": (Kind.BOOLEAN, "BOOLEAN"),
}


@dataclass(frozen=True, eq=False)
class LinkedLayer:
    """A layer or vertex group of the target that follows one of the source.

    Attributes:
        name: its name.
        of_source: its name on the source.
        domain: the elements that have values, on both meshes.
        data_type: a key of `NODE_TYPES`.
        picks: the elements of the source that each element of the target reads.
        linked: (q,) the elements of the target that follow; others keep their values.
    """

    name: str
    of_source: str
    domain: Domain
    data_type: str
    picks: Picks
    linked: Booleans


def link_modifier(obj: Object) -> NodesModifier | None:
    """The modifier that links an object to its source, or None."""
    for modifier in obj.modifiers:
        if modifier.type == "NODES" and modifier.node_group is not None and MARK in modifier.node_group:
            return modifier
    return None


def write_link(target: Object, source: Object, evaluated: zo.Surface, layers: Sequence[LinkedLayer]) -> None:
    """Link layers of a target to those of a source; replaces an earlier link.

    It becomes the first modifier, so that other modifiers use its values.

    Args:
        target: the object that follows.
        source: the object that it follows.
        evaluated: the source's surface, whose elements are numbered.
        layers: the layers and vertex groups that follow; they exist on the target.
    """
    remove_link_attributes(target)
    name = f"ZoomOut Link {target.name}"
    tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
    tree[MARK] = True
    _build(tree, target, source, evaluated, layers, _write_picks(target, layers))
    modifier = link_modifier(target)
    if modifier is None:
        modifier = target.modifiers.new("ZoomOut Link", "NODES")
        target.modifiers.move(target.modifiers.find(modifier.name), 0)
    _use(modifier, tree)
    tree.name = name  # which the one before may have had


def remove_link(obj: Object) -> bool:
    """Remove the link of an object, whose values stay as in its mesh; returns whether there was one."""
    modifier = link_modifier(obj)
    had_attributes = remove_link_attributes(obj)
    if modifier is None:
        return had_attributes
    _use(modifier, None)
    obj.modifiers.remove(modifier)
    return True


def _use(modifier: NodesModifier, tree: GeometryNodeTree | None) -> None:
    """Replace the node group of a modifier; the one before is removed unless another object of the file uses it."""
    before = modifier.node_group
    modifier.node_group = tree
    objects = (obj for obj in bpy.data.objects if obj.users)  # without those that `all_or_nothing` keeps
    if before is not None and all(
        getattr(each, "node_group", None) != before for obj in objects for each in obj.modifiers
    ):
        remove_when_written(before)


def remove_link_attributes(obj: Object) -> bool:
    """Remove the attributes of a link from the mesh of an object; returns whether there were any."""
    names = [attribute.name for attribute in obj.data.attributes if attribute.name.startswith(LINK_ATTRIBUTES)]
    for name in names:
        obj.data.attributes.remove(obj.data.attributes[name])
    return bool(names)


def _write_picks(target: Object, layers: Sequence[LinkedLayer]) -> list[str]:
    """Write the picks of layers to the target's mesh, equal ones once; returns the prefix of the names for each."""
    prefixes: dict[str, str] = {}
    found = []
    for layer in layers:
        picks = layer.picks
        key = hash_of(layer.domain.name, picks.elements, picks.weights, layer.linked)
        if key not in prefixes:
            prefixes[key] = f"{LINK_ATTRIBUTES}{len(prefixes)}"
            columns = (*picks.elements.T, *picks.weights.T, layer.linked)
            for (end, (kind, data_type)), values in zip(PICKS.items(), columns, strict=True):
                stored = Attribute(prefixes[key] + end, layer.domain, kind, values)
                write_layer(target.data, Layer(stored, Role.GENERIC, data_type))
        found.append(prefixes[key])
    return found


def _build(
    tree: GeometryNodeTree,
    target: Object,
    source: Object,
    evaluated: zo.Surface,
    layers: Sequence[LinkedLayer],
    prefixes: Sequence[str],
) -> None:
    """Fill a node group; `prefixes` are those of the picks of each layer."""
    nodes = _Nodes(tree)
    own, read = nodes.begin(), nodes.node("GeometryNodeObjectInfo", source).outputs["Geometry"]
    linked = own
    for domain in dict.fromkeys(layer.domain for layer in layers):
        members = [pair for pair in zip(layers, prefixes, strict=True) if pair[0].domain is domain]
        nodes.next_row()
        copy, values = nodes.capture(read, [layer for layer, _ in members])
        for (layer, prefix), value in zip(members, values, strict=True):
            nodes.next_row()
            linked = _store_mixture(nodes, linked, copy, layer, value, prefix)
    nodes.next_row()
    counts = (
        (read, "Point Count", len(evaluated.vertices)),
        (read, "Face Corner Count", len(evaluated.corner_vertex)),
        (own, "Point Count", len(target.data.vertices)),
        (own, "Face Corner Count", len(target.data.loops)),
    )
    valid: NodeSocket | None = None
    for geometry, kind, count in counts:
        size = nodes.node("GeometryNodeAttributeDomainSize", geometry, component="MESH").outputs[kind]
        equal = nodes.node("FunctionNodeCompare", size, count, data_type="INT", operation="EQUAL").outputs["Result"]
        valid = (
            equal if valid is None else nodes.node("FunctionNodeBooleanMath", valid, equal, operation="AND").outputs[0]
        )
    nodes.finish(nodes.node("GeometryNodeSwitch", valid, own, linked, input_type="GEOMETRY").outputs[0])


def _store_mixture(
    nodes: _Nodes, geometry: NodeSocket, source: NodeSocket, layer: LinkedLayer, value: NodeSocket, prefix: str
) -> NodeSocket:
    """Add the nodes of one layer to the end of the target's geometry, which they pass if the source lost the layer.

    Args:
        nodes: where to add them.
        geometry: the target's.
        source: the geometry on which `value` is sampled.
        layer: the layer.
        value: its values on the source.
        prefix: of the names of its picks.
    """
    types, domain = NODE_TYPES[layer.data_type], layer.domain.name
    *picks, follows = (nodes.attribute(prefix + end, data_type).outputs[0] for end, (_, data_type) in PICKS.items())
    elements, weights = picks[:3], picks[3:]
    if types.sampled in ("INT", "BOOLEAN"):
        mixed = nodes.sample(source, value, elements[0], types.sampled, domain)
    else:
        sampled = [nodes.sample(source, value, each, types.sampled, domain) for each in elements]
        mixed = _MIXTURES[types.sampled](nodes, sampled, weights)
    settings = {"data_type": types.stored, "domain": domain}
    stored = nodes.node("GeometryNodeStoreNamedAttribute", geometry, follows, layer.name, mixed, **settings)
    there = nodes.attribute(layer.of_source, types.sampled).outputs["Exists"]
    exists = nodes.sample(source, there, 0, "BOOLEAN", domain)
    return nodes.node("GeometryNodeSwitch", exists, geometry, stored.outputs[0], input_type="GEOMETRY").outputs[0]


class _Nodes:
    """Builds the nodes of a group in rows, from left to right."""

    def __init__(self, tree: GeometryNodeTree) -> None:
        for direction in ("INPUT", "OUTPUT"):
            tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
        tree.is_modifier = True
        self._tree = tree
        self._place = [0, 0]

    def begin(self) -> NodeSocket:
        """Add the input, and return the target's geometry."""
        return self.node("NodeGroupInput").outputs[0]

    def finish(self, geometry: NodeSocket) -> None:
        """Add the output of the result."""
        self.node("NodeGroupOutput", geometry)

    def next_row(self) -> None:
        """Place the following nodes below."""
        self._place = [0, self._place[1] - ROW]

    def node(self, kind: str, *inputs: object, **settings: str) -> Node:
        """Add a node with these settings, whose available inputs are linked, or set to a value."""
        node = self._tree.nodes.new(kind)
        node.location = self._place
        self._place[0] += COLUMN
        for name, value in settings.items():
            setattr(node, name, value)
        available = [socket for socket in node.inputs if socket.enabled]
        for socket, given in zip(available, inputs, strict=False):
            if isinstance(given, NodeSocket):
                self._tree.links.new(given, socket)
            else:
                socket.default_value = given
        return node

    def attribute(self, name: str, data_type: str) -> Node:
        """Add the node of a named attribute."""
        return self.node("GeometryNodeInputNamedAttribute", name, data_type=data_type)

    def sample(
        self, source: NodeSocket, value: NodeSocket, element: NodeSocket | int, data_type: str, domain: str
    ) -> NodeSocket:
        """Add the node that reads a field of another geometry at an element."""
        settings = {"data_type": data_type, "domain": domain}
        return self.node("GeometryNodeSampleIndex", source, value, element, **settings).outputs["Value"]

    def capture(self, source: NodeSocket, layers: Sequence[LinkedLayer]) -> tuple[NodeSocket, list[NodeSocket]]:
        """Add the nodes that read layers of one domain; returns the geometry to sample them on, and their values."""
        node = self.node("GeometryNodeCaptureAttribute", source, domain=layers[0].domain.name)
        names = [str(number) for number in range(len(layers))]  # from Blender 5.2 on, the node has further sockets
        for name, layer in zip(names, layers, strict=True):
            kind = NODE_TYPES[layer.data_type].sampled
            node.capture_items.new(SOCKETS[kind], name)
            self._tree.links.new(self.attribute(layer.of_source, kind).outputs[0], node.inputs[name])
        return node.outputs[0], [node.outputs[name] for name in names]

    def mix_numbers(self, values: Sequence[object], weights: Sequence[NodeSocket]) -> NodeSocket:
        """Add the nodes of the sum of three weighted numbers."""
        total: object = 0.0
        for value, weight in zip(values, weights, strict=True):
            total = self.node("ShaderNodeMath", value, weight, total, operation="MULTIPLY_ADD").outputs[0]
        return total

    def mix_vectors(self, values: Sequence[NodeSocket], weights: Sequence[NodeSocket]) -> NodeSocket:
        """Add the nodes of the sum of three weighted vectors."""
        total: object = (0.0, 0.0, 0.0)
        for value, weight in zip(values, weights, strict=True):
            scaled = self.node("ShaderNodeVectorMath", value, operation="SCALE")
            self._tree.links.new(weight, scaled.inputs["Scale"])
            total = self.node("ShaderNodeVectorMath", scaled.outputs[0], total, operation="ADD").outputs[0]
        return total

    def mix_colors(self, values: Sequence[NodeSocket], weights: Sequence[NodeSocket]) -> NodeSocket:
        """Add the nodes of the sum of three weighted colours with alpha, scene-linear."""
        alphas = [self.node("FunctionNodeSeparateColor", value).outputs["Alpha"] for value in values]
        alpha = self.mix_numbers(alphas, weights)
        rgb = self.node("ShaderNodeSeparateXYZ", self.mix_vectors(values, weights)).outputs
        return self.node("FunctionNodeCombineColor", *rgb, alpha).outputs[0]


_MIXTURES = {
    "FLOAT": _Nodes.mix_numbers,
    "FLOAT_VECTOR": _Nodes.mix_vectors,
    "FLOAT_COLOR": _Nodes.mix_colors,
}
