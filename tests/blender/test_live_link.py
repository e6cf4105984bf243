# SPDX-License-Identifier: GPL-3.0-or-later
"""A linked target follows edits of its source, as another transfer would change it, and nothing else."""

import bpy
import numpy as np
import pytest
from scenes import (
    ELEMENTS,
    activate,
    add_attribute,
    add_uv_map,
    decimate,
    delete_vertex,
    ellipsoid,
    positions,
    set_weights,
    snapshot_file,
    values,
)
from true_match import keep_true_match

import zoomout_core as zo
from blender_addon.adapters import Settings
from blender_addon.mesh_data import (
    LinkedLayer,
    all_or_nothing,
    link_modifier,
    read_source_surface,
    read_weights,
    write_link,
)
from blender_addon.services import live_link as service
from blender_addon.services.live_link import keep_linked, update_linked
from blender_addon.services.transfer import transfer_objects
from blender_addon.storage import stored_link
from blender_addon.storage.stored_link import has_older_match, link_of
from zoomout_core.transfer import Domain
from zoomout_core.transfer.picks import Picks

FLOATS = ("FLOAT", "FLOAT2", "FLOAT_VECTOR", "FLOAT_COLOR", "BYTE_COLOR")
LABELS = ("INT", "INT8", "BOOLEAN")
# The halves of an atlas of two islands, by the sign of x.
ISLANDS = np.array([[0.1, 0.1], [0.6, 0.5]])


@pytest.fixture
def source():
    return ellipsoid("Source", 4)


@pytest.fixture
def target(source):
    obj = decimate("Target", 4)
    keep_true_match(obj)
    activate(obj, source)
    return obj


def add_layers(mesh, seed):
    """A layer of each kind, or other values of it: smooth numbers, labels of halves, and UVs of two islands."""
    random = np.random.default_rng(seed)
    corner_vertex = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corner_vertex)
    face = np.repeat(np.arange(len(mesh.polygons)), 3)
    points = positions(mesh)
    side = (points[corner_vertex[::3], 0] > 0).astype(int)
    uv = ISLANDS[side[face]] + points[corner_vertex, 1:] @ random.normal(size=(2, 2)) * 0.05
    layers = {("UVMap", "FLOAT2", "CORNER"): uv}
    for kind in FLOATS:
        width = ELEMENTS[kind][1]
        smooth = np.abs(np.tanh(points @ random.normal(size=(3, width))))
        layers[f"point {kind}", kind, "POINT"] = smooth
        if kind != "FLOAT2":  # would be a UV map
            layers[f"corner {kind}", kind, "CORNER"] = smooth[corner_vertex] + 0.3 * side[face, None]
    of_side = random.permutation(2)[side]
    for kind in LABELS:
        layers[f"face {kind}", kind, "FACE"] = of_side
        layers[f"corner {kind}", kind, "CORNER"] = of_side[face]
        layers[f"point {kind}", kind, "POINT"] = points[:, 0] > random.uniform(-0.1, 0.1)
    for (name, kind, domain), array in layers.items():
        if name in mesh.attributes:
            element, _, dtype = ELEMENTS[kind]
            mesh.attributes[name].data.foreach_set(element, np.ascontiguousarray(array, dtype).ravel())
        else:
            add_attribute(mesh, name, kind, domain, array)
    mesh.update()
    return {name for name, _, _ in layers}


def visible(obj):
    """The values of all layers, and weights (n, groups), after modifiers."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    evaluated = obj.evaluated_get(depsgraph)
    mesh = evaluated.to_mesh(preserve_all_data_layers=True, depsgraph=depsgraph)
    found = {layer.name: values(mesh, layer.name).astype(float) for layer in mesh.attributes if _is_shown(layer)}
    weights = read_weights(evaluated, mesh)
    found |= {name: weights.values[:, [number]].toarray()[:, 0] for number, name in enumerate(weights.labels)}
    evaluated.to_mesh_clear()
    return found


def _is_shown(layer):
    return layer.data_type in ELEMENTS and not layer.name.startswith(".")


def differences(one, other):
    """The largest difference of each layer."""
    return {name: np.abs(one[name] - other[name]).max() for name in one}


def test_linked_target_follows_all_layers_like_a_transfer(source, target):
    names = add_layers(source.data, 0)
    set_weights(source, "Left", np.clip(positions(source.data)[:, 0] + 0.5, 0, 1))
    shares = keep_linked(bpy.context, target)
    assert shares.keys() >= names | {"Left"}
    assert min(shares.values()) > 0.99
    linked = visible(target)
    modifier = link_modifier(target)
    modifier.show_viewport = False
    assert max(differences(linked, visible(target)).values()) < 1e-5

    add_layers(source.data, 1)
    source.vertex_groups["Left"].add(range(300), 0.25, "REPLACE")
    modifier.show_viewport = True
    followed = visible(target)
    modifier.show_viewport = False
    transfer_objects(bpy.context, source, target)
    written = visible(target)
    for name in names | {"Left"}:
        assert np.abs(followed[name] - linked[name]).max() > 0.01, name
        differ = np.abs(followed[name] - written[name]).reshape(len(written[name]), -1).max(axis=1) > 1e-5
        # A transfer decides again on labels and islands at their borders.
        elected = name.endswith((*LABELS, "UVMap"))
        assert differ.mean() <= (0.05 if elected else 1 - shares[name] + 1e-9), name


def test_vertex_groups_of_the_source_are_read_once(source, target):
    """Blender searches the groups of a vertex for each value: other nodes read the captured ones."""
    for name in ("Left", "Right"):
        set_weights(source, name, np.clip(positions(source.data)[:, 0] + 0.5, 0, 1))
    keep_linked(bpy.context, target, ["vertex_groups"])
    nodes = link_modifier(target).node_group.nodes
    samples = [node for node in nodes if node.bl_idname == "GeometryNodeSampleIndex" and node.data_type == "FLOAT"]
    assert len(samples) == 6
    assert {node.inputs["Value"].links[0].from_node.bl_idname for node in samples} == {"GeometryNodeCaptureAttribute"}
    assert not any(layer.name.startswith(".a_") for layer in evaluated_layers(target))  # nothing captured stays


def evaluated_layers(obj):
    return obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.attributes


def test_sources_of_any_size_are_numbered_exactly(source, target):
    count = len(target.data.vertices)
    elements = np.arange(3 * count).reshape(-1, 3) + (1 << 24)  # beyond here, single precision skips numbers
    picks = Picks(elements, np.full((count, 3), 1 / 3))
    everything = np.ones(count, dtype=bool)
    surface = read_source_surface(source, bpy.context.evaluated_depsgraph_get())
    write_link(target, source, surface, [LinkedLayer("a", "a", Domain.POINT, "FLOAT", picks, everything)])
    stored = [values(target.data, f".zoomout_link_0_element_{number}") for number in range(3)]
    np.testing.assert_array_equal(np.column_stack(stored), elements)


def test_faces_at_a_seam_follow_their_own_island(source, target):
    """Moving one island moves the UVs of whole faces, never a part of their corners."""
    add_layers(source.data, 0)
    keep_linked(bpy.context, target)
    before = visible(target)["UVMap"]
    uv = values(source.data, "UVMap")
    add = np.where(uv[:, :1] > 0.35, 0.125, 0)
    source.data.attributes["UVMap"].data.foreach_set("vector", (uv + add).astype(np.float32).ravel())
    source.data.update()
    moved = np.abs(visible(target)["UVMap"] - before).max(axis=1).reshape(-1, 3)
    np.testing.assert_allclose(moved, moved[:, :1].repeat(3, axis=1), atol=1e-6)
    assert {0.0, 0.125} == set(np.round(moved, 5).ravel().tolist())


def test_doubtful_vertices_keep_what_was_filled_in(source, target):
    keep_true_match(target, doubtful=50)
    add_attribute(source.data, "heat", "FLOAT", "POINT", positions(source.data)[:, 0])
    dark = np.abs(positions(source.data)[:, [0, 1, 2, 2]]) * 0.01  # where colours of eight bits are dense
    add_attribute(source.data, "tint", "BYTE_COLOR", "POINT", dark)
    shares = keep_linked(bpy.context, target, ["attributes", "color_attributes"], Settings(fill_below=0.5))
    assert abs(shares["heat"] - (1 - 50 / len(target.data.vertices))) < 0.01
    linked, modifier = visible(target), link_modifier(target)
    modifier.show_viewport = False
    differ = differences(linked, visible(target))
    assert differ["heat"] < 1e-5
    assert differ["tint"] < 6e-4  # a step of a dark colour
    modifier.show_viewport = True
    before = linked["heat"]
    source.data.attributes["heat"].data.foreach_set("value", np.full(len(source.data.vertices), 9, np.float32))
    source.data.update()
    after = visible(target)["heat"]
    np.testing.assert_array_equal(after[:50], before[:50])
    np.testing.assert_allclose(after[60:], 9, rtol=1e-6)


@pytest.mark.parametrize("edited", ["Source", "Target"])
def test_a_mesh_with_other_vertices_stops_the_link_until_the_next_match(source, target, edited):
    add_attribute(source.data, "heat", "FLOAT", "POINT", positions(source.data)[:, 0])
    keep_linked(bpy.context, target, ["attributes"])
    delete_vertex(bpy.data.objects[edited])
    source.data.attributes["heat"].data.foreach_set("value", np.full(len(source.data.vertices), 9, np.float32))
    source.data.update()
    assert visible(target)["heat"].max() < 2
    with pytest.raises(zo.MeshError, match=f"'{edited}' was edited .*match again"):
        update_linked(bpy.context, target)
    keep_true_match(target)
    assert has_older_match(target)
    update_linked(bpy.context, target)
    assert not has_older_match(target)
    np.testing.assert_allclose(visible(target)["heat"], 9, rtol=1e-6)


def test_layer_removed_from_source_stays_on_target(source, target):
    add_uv_map(source.data, "UVMap")
    keep_linked(bpy.context, target, ["uv_maps"])
    before = visible(target)["UVMap"]
    source.data.uv_layers.remove(source.data.uv_layers["UVMap"])
    np.testing.assert_array_equal(visible(target)["UVMap"], before)


def test_modifiers_below_use_the_linked_weights(source, target):
    """The modifier is the first, and writes vertex groups."""
    right = positions(source.data)[:, 0] > 0.8
    set_weights(source, "Bone", right)
    displace = target.modifiers.new("Displace", "DISPLACE")
    keep_linked(bpy.context, target, ["vertex_groups"])
    displace.vertex_group = "Bone"
    assert target.modifiers[0] == link_modifier(target)
    still = positions(target.data)[:, 0] < 0.4
    assert np.abs(visible(target)["position"] - positions(target.data))[still].max() < 1e-6
    source.vertex_groups["Bone"].add(np.flatnonzero(~right).tolist(), 1.0, "REPLACE")
    source.data.update()
    assert np.linalg.norm(visible(target)["position"] - positions(target.data), axis=1).min() > 0.1


def test_update_transfers_data_that_modifiers_cannot_write(source, target):
    source.shape_key_add(name="Basis")
    key = source.shape_key_add(name="Smile")
    set_weights(source, "Old", np.ones(len(source.data.vertices)))
    keep_linked(bpy.context, target, ["shape_keys", "vertex_groups"])
    key.points[0].co.z += 0.5
    set_weights(source, "New", np.ones(len(source.data.vertices)))
    shares = update_linked(bpy.context, target)
    moved = np.array([point.co.z for point in target.data.shape_keys.key_blocks["Smile"].points])
    assert np.abs(moved - positions(target.data)[:, 2]).max() > 0.01
    assert shares["New"] == 1  # with the data that was chosen for Keep Linked


def test_a_link_survives_saving_appending_and_linking(source, target, tmp_path):
    add_uv_map(source.data, "UVMap")
    keep_linked(bpy.context, target, ["uv_maps"])
    path = str(tmp_path / "linked.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    check_follows(bpy.data.objects["Source"], bpy.data.objects["Target"])
    assert stored_link.description(bpy.data.objects["Target"].data)["source"] == "Source"
    for linked in (False, True):
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
        with bpy.data.libraries.load(path, link=linked) as (_, into):
            into.objects = ["Target"]
        (target,) = into.objects
        bpy.context.scene.collection.objects.link(target)
        source = link_modifier(target).node_group.nodes["Object Info"].inputs["Object"].default_value
        assert source.name == "Source"
        if not linked:
            bpy.context.scene.collection.objects.link(source)
            check_follows(source, target)
    assert link_modifier(target).node_group.library is not None
    assert "UVMap" in visible(target)


@pytest.mark.parametrize("whole", [True, False], ids=["collection", "target alone"])
def test_a_link_survives_library_overrides(source, target, tmp_path, whole):
    """A target that is overridden follows the source, which is edited in its own file."""
    add_uv_map(source.data, "UVMap")
    keep_linked(bpy.context, target, ["uv_maps"])
    hero = bpy.data.collections.new("Hero")
    bpy.context.scene.collection.children.link(hero)
    for obj in (source, target):
        hero.objects.link(obj)
    library, scene = str(tmp_path / "hero.blend"), str(tmp_path / "scene.blend")
    bpy.ops.wm.save_as_mainfile(filepath=library)

    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(library, link=True) as (_, into):
        into.collections, into.objects = (["Hero"], []) if whole else ([], ["Target"])
    if whole:
        into.collections[0].override_hierarchy_create(bpy.context.scene, bpy.context.view_layer)
    else:
        bpy.context.scene.collection.objects.link(into.objects[0].override_create())
    before = visible(overridden("Target"))["UVMap"]
    bpy.ops.wm.save_as_mainfile(filepath=scene)

    bpy.ops.wm.open_mainfile(filepath=library)
    uv = values(bpy.data.objects["Source"].data, "UVMap") + np.float32(0.25)
    bpy.data.objects["Source"].data.attributes["UVMap"].data.foreach_set("vector", uv.ravel())
    bpy.ops.wm.save_mainfile()

    bpy.ops.wm.open_mainfile(filepath=scene)
    target = overridden("Target")
    np.testing.assert_allclose(visible(target)["UVMap"], before + 0.25, atol=1e-5)
    followed = link_modifier(target).node_group.nodes["Object Info"].inputs["Object"].default_value
    assert (followed.override_library is not None) == whole
    assert link_of(target)["source"] == "Source"
    with pytest.raises(zo.MeshError, match="linked from another file" if whole else "no source"):
        update_linked(bpy.context, target)


def overridden(name):
    """The library override with a name."""
    return next(obj for obj in bpy.data.objects if obj.name == name and obj.override_library)


def check_follows(source, target):
    before = visible(target)["UVMap"]
    uv = values(source.data, "UVMap") + np.float32(0.25)
    source.data.attributes["UVMap"].data.foreach_set("vector", uv.ravel())
    source.data.update()
    np.testing.assert_allclose(visible(target)["UVMap"], before + 0.25, atol=1e-5)


def test_operators_link_and_update_the_selected_targets(source, target):
    other = decimate("Other", 4)
    keep_true_match(other)
    add_uv_map(source.data, "UVMap")
    activate(target, source, other)
    assert not bpy.ops.zoomout.update_linked.poll()
    assert bpy.ops.zoomout.keep_linked() == {"FINISHED"}
    assert bpy.ops.zoomout.update_linked() == {"FINISHED"}
    for obj in (target, other):
        assert link_modifier(obj) is not None
        assert len(obj.modifiers) == 1
        check_follows(source, obj)
    assert len([tree for tree in bpy.data.node_groups if "Link" in tree.name]) == 2
    assert link_modifier(source) is None


def test_linking_and_updating_are_one_undo_step_each(source, target):
    add_uv_map(source.data, "UVMap")
    set_weights(source, "Arm", np.ones(len(source.data.vertices)))
    activate(target, source)
    for operator in (bpy.ops.zoomout.keep_linked, bpy.ops.zoomout.update_linked):
        bpy.ops.ed.undo_push(message="Before")
        before = snapshot_file()
        assert operator("EXEC_DEFAULT", True) == {"FINISHED"}
        assert snapshot_file() != before
        bpy.ops.ed.undo()
        assert snapshot_file() == before
        assert operator("EXEC_DEFAULT", True) == {"FINISHED"}
        bpy.data.objects["Target"].vertex_groups.clear()


def test_linking_again_leaves_nothing_of_the_link_before(source, target):
    add_uv_map(source.data, "UVMap")
    keep_linked(bpy.context, target, ["uv_maps"])
    before = snapshot_file()
    keep_linked(bpy.context, target, ["uv_maps"])
    assert snapshot_file() == before


def test_clearing_removes_the_link_and_keeps_the_values(source, target):
    add_uv_map(source.data, "UVMap")
    transfer_objects(bpy.context, source, target, ["uv_maps"])
    keep_linked(bpy.context, target, ["uv_maps"])
    uv = values(target.data, "UVMap").copy()
    assert bpy.ops.zoomout.clear_match_data() == {"FINISHED"}
    assert not target.modifiers
    assert not bpy.data.node_groups
    assert stored_link.description(target.data) is None
    assert not any("zoomout" in layer.name for layer in target.data.attributes)
    np.testing.assert_array_equal(values(target.data, "UVMap"), uv)


def test_impossible_links_are_refused_before_writing(source, target):
    add_uv_map(source.data, "UVMap")
    before = snapshot_file()
    with pytest.raises(zo.MeshError, match="Factor to 1"):
        keep_linked(bpy.context, target, settings=Settings(factor=0.5))
    with pytest.raises(zo.MeshError, match="'Target' is not linked"):
        update_linked(bpy.context, target)
    source.modifiers.new("Subdivision", "SUBSURF")
    with pytest.raises(zo.MeshError, match="added after the match: match again"):
        keep_linked(bpy.context, target)
    source.modifiers.clear()
    assert snapshot_file() == before


@pytest.mark.parametrize("step", ["_store_mixture", "_use"])
def test_a_failure_while_linking_leaves_everything_as_it_was(source, target, monkeypatch, step):
    add_uv_map(source.data, "UVMap")
    before = snapshot_file()

    def fail(*_):
        raise RuntimeError("as if Blender lacked a node")

    monkeypatch.setattr(service.mesh_data.objects.live_link, step, fail)
    with pytest.raises(RuntimeError):
        keep_linked(bpy.context, target, ["uv_maps"])
    assert snapshot_file() == before


@pytest.mark.parametrize("linked_before", [False, True])
def test_a_failure_after_linking_restores_the_modifier_and_its_nodes(source, target, linked_before):
    add_uv_map(source.data, "UVMap")
    if linked_before:
        keep_linked(bpy.context, target, ["uv_maps"])
    before, groups = snapshot_file(), [modifier.node_group.name for modifier in target.modifiers]

    def link_two():
        with all_or_nothing():
            keep_linked(bpy.context, target, ["uv_maps"])
            raise RuntimeError("as if another target could not be linked")

    with pytest.raises(RuntimeError):
        link_two()
    assert [modifier.node_group.name for modifier in target.modifiers] == groups
    assert snapshot_file() == before


def test_a_link_ends_when_its_modifier_is_removed(source, target):
    add_uv_map(source.data, "UVMap")
    keep_linked(bpy.context, target, ["uv_maps"])
    assert link_of(target)["source"] == "Source"
    target.modifiers.clear()
    assert link_of(target) is None
    with pytest.raises(zo.MeshError, match="'Target' is not linked"):
        update_linked(bpy.context, target)
    assert not bpy.ops.zoomout.update_linked.poll()
    keep_linked(bpy.context, target, ["uv_maps"])
    assert bpy.ops.zoomout.update_linked.poll()
