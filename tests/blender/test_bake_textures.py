# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures of the source show the same places in the target's atlas, and its materials use them."""

from pathlib import Path

import bpy
import numpy as np
import pytest
from scenes import activate, add_uv_map, decimate, ellipsoid, positions, snapshot_file
from true_match import keep_true_match

import zoomout_core as zo
from blender_addon import api, mesh_data
from blender_addon.jobs import Job
from blender_addon.services.bake import prepare_bake
from zoomout_core.transfer.uv.tangents import tangent_space

SIZE = 32


def new_image(name, values, is_float=False, space="Non-Color"):
    """An image of texels (h, w, 4) from bottom to top."""
    image = bpy.data.images.new(name, SIZE, SIZE, alpha=True, float_buffer=is_float)
    image.colorspace_settings.name = space
    image.pixels.foreach_set(np.ascontiguousarray(values, np.float32).ravel())
    return image


def pixels(image):
    values = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4)


def ramp():
    """Red is u, green is v."""
    u, v = np.meshgrid((np.arange(SIZE) + 0.5) / SIZE, (np.arange(SIZE) + 0.5) / SIZE)
    return np.stack([u, v, 0 * u, 0 * u + 1], axis=-1)


@pytest.fixture
def source():
    """An ellipsoid whose material has a color, a float mask of roughness and a normal map."""
    obj = ellipsoid("Source", 4)
    add_uv_map(obj.data, "UVMap")
    material = bpy.data.materials.new("Skin")
    if bpy.app.version < (5, 0):  # later materials always use nodes
        material.use_nodes = True
    tree = material.node_tree
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Metallic"].default_value = 0.75

    def texture(image):
        node = tree.nodes.new("ShaderNodeTexImage")
        node.image = image
        return node.outputs["Color"]

    tree.links.new(texture(new_image("color", ramp(), space="sRGB")), shader.inputs["Base Color"])
    tree.links.new(texture(new_image("rough", 4 * ramp(), is_float=True)), shader.inputs["Roughness"])
    normal = tree.nodes.new("ShaderNodeNormalMap")
    tree.links.new(texture(new_image("normal", np.tile([0.5, 0.5, 1, 1], (SIZE, SIZE, 1)))), normal.inputs["Color"])
    tree.links.new(normal.outputs["Normal"], shader.inputs["Normal"])
    obj.data.materials.append(material)
    return obj


@pytest.fixture
def target(source):
    """A coarser mesh whose atlas has x and y the other way round, and in half of the square."""
    obj = decimate("Target", 4)
    add_uv_map(obj.data, "Atlas")
    layer = obj.data.uv_layers["Atlas"].uv
    uv = np.empty(2 * len(layer), np.float32)
    layer.foreach_get("vector", uv)
    uv = np.ascontiguousarray(uv.reshape(-1, 2)[:, ::-1])
    layer.foreach_set("vector", uv.ravel())
    keep_true_match(obj)
    activate(obj, source)
    return obj


def test_baked_images_show_the_same_places_in_the_atlas(source, target):
    report = api.bake_textures(bpy.context, target, api.Baking(size=64))
    assert report["images"] == {
        "Base Color": "Target Base Color",
        "Roughness": "Target Roughness",
        "Normal": "Target Normal",
    }
    color, rough, normal = (bpy.data.images[name] for name in report["images"].values())
    middle = pixels(color)[24:40, 24:40]
    v, u = np.meshgrid((np.arange(24, 40) + 0.5) / 64, (np.arange(24, 40) + 0.5) / 64)
    assert np.abs(middle[:, :, 0] - u).max() < 0.03  # the source's u runs along the rows
    assert np.abs(middle[:, :, 1] - v).max() < 0.03
    assert color.colorspace_settings.name == "sRGB"
    assert {image.colorspace_settings.name for image in (rough, normal)} == {"Non-Color"}
    assert rough.is_float
    assert np.abs(pixels(rough)[24:40, 24:40, 0] - 4 * u).max() < 0.12
    assert np.abs(pixels(normal)[24:40, 24:40, :3] - [0.5, 0.5, 1]).max() < 0.02
    assert all(image.packed_file for image in (color, rough, normal))
    (material,) = target.data.materials
    assert material.name == "Skin on Target"
    shown = {node.image for node in material.node_tree.nodes if node.type == "TEX_IMAGE"}
    assert shown == {color, rough, normal}
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    assert shader.inputs["Metallic"].default_value == 0.75
    assert {node.uv_map for node in material.node_tree.nodes if node.type == "UVMAP"} == {"Atlas"}


def test_baking_again_replaces_images_and_materials(source, target):
    first = api.bake_textures(bpy.context, target, api.Baking(size=16))
    assert api.bake_textures(bpy.context, target, api.Baking(size=32)) == first
    assert bpy.data.images["Target Base Color"].size[:] == (32, 32)
    assert bpy.data.materials.keys().count("Skin on Target") == 1
    assert not [name for name in (*bpy.data.images.keys(), *bpy.data.materials.keys()) if "before" in name]


def test_udim_tiles_are_baked_separately(source, target, tmp_path):
    """The source's left half is in a second tile, and the target's atlas has two tiles as well."""
    for obj, name in ((source, "UVMap"), (target, "Atlas")):
        layer = obj.data.uv_layers[name].uv
        uv = np.empty(2 * len(layer), np.float32)
        layer.foreach_get("vector", uv)
        uv = uv.reshape(-1, 2)
        faces = positions(obj.data)[[vertex for face in obj.data.polygons for vertex in face.vertices], 0]
        left = np.repeat(faces.reshape(-1, 3).mean(axis=1) < 0, 3)
        uv[left, 0] += 1
        layer.foreach_set("vector", uv.ravel())
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    for number, level in ((1001, 0.25), (1002, 0.75)):
        one = new_image(f"tile.{number}", np.full((SIZE, SIZE, 4), level))
        one.filepath_raw, one.file_format = str(tmp_path / f"tile.{number}.png"), "PNG"
        one.save()
    tiled = bpy.data.images.load(str(tmp_path / "tile.1001.png"))
    tiled.source, tiled.filepath_raw = "TILED", str(tmp_path / "tile.<UDIM>.png")
    tiled.tiles.new(1002)
    color = next(node for node in source.data.materials[0].node_tree.nodes if node.type == "TEX_IMAGE")
    color.image = tiled
    report = api.bake_textures(bpy.context, target, api.Baking(size=32, save=True))
    image = bpy.data.images[report["images"]["Base Color"]]
    assert [tile.number for tile in image.tiles] == [1001, 1002]
    for number, rows, level in ((1001, slice(19, 22), 64), (1002, slice(10, 13), 191)):
        saved = bpy.data.images.load(str(tmp_path / "textures" / f"Target_Base_Color.{number}.png"))
        np.testing.assert_allclose(255 * pixels(saved)[rows, 14:18, 0], level, atol=1)


def test_impossible_bake_is_reported_and_changes_nothing(source, target):
    node = next(node for node in source.data.materials[0].node_tree.nodes if node.type == "TEX_IMAGE")
    tree = node.id_data
    tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"], node.inputs["Vector"])
    report = api.bake_textures(bpy.context, target, api.Baking(size=16))
    assert report["notes"] == ["The image 'color' was not baked: it is not placed by a UV map."]
    before = snapshot_file()
    for change, reason in (
        (lambda: source.data.materials.clear(), "no image textures to bake"),
        (lambda: target.data.uv_layers.remove(target.data.uv_layers["Atlas"]), "no UV map to bake to"),
    ):
        change()
        before = snapshot_file()
        with pytest.raises(zo.MeshError, match=reason):
            api.bake_textures(bpy.context, target, api.Baking(size=16))
        assert snapshot_file() == before
    with pytest.raises(zo.MeshError, match=r"Save the \.blend file first"):
        api.bake_textures(bpy.context, target, api.Baking(save=True))


def test_a_bake_that_is_cancelled_leaves_everything_as_it_was(source, target, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    before, files = snapshot_file(), sorted(tmp_path.rglob("*"))
    job = Job(prepare_bake(bpy.context, target.name, api.Baking(size=1024, save=True)))
    shown = [job.progress.fraction]
    while shown[-1] < 0.4:
        assert not job.advance(0)
        shown.append(job.progress.fraction)
    job.cancel()
    assert shown == sorted(shown)
    assert shown[-1] < 1
    assert snapshot_file() == before
    assert sorted(tmp_path.rglob("*")) == files


def test_images_that_cannot_all_be_saved_leave_the_earlier_files(source, target, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    api.bake_textures(bpy.context, target, api.Baking(size=16, save=True))
    folder = tmp_path / "textures"
    names = ["Target_Base_Color.png", "Target_Normal.png", "Target_Roughness.exr"]
    assert sorted(path.name for path in folder.iterdir()) == names
    (folder / names[2]).unlink()
    (folder / names[2]).mkdir()
    before, kept = snapshot_file(), {name: (folder / name).read_bytes() for name in names[:2]}
    with pytest.raises(zo.MeshError, match=r"'Target_Roughness\.exr' cannot be saved"):
        api.bake_textures(bpy.context, target, api.Baking(size=32, save=True))
    assert snapshot_file() == before
    assert {name: (folder / name).read_bytes() for name in names[:2]} == kept
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scene.blend", "textures"]


def test_saved_images_are_read_from_their_folder(source, target, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    report = api.bake_textures(bpy.context, target, api.Baking(size=16, save=True))
    for name in report["images"].values():
        image = bpy.data.images[name]
        shown = pixels(image)
        assert Path(bpy.path.abspath(image.filepath)).parent == tmp_path / "textures"
        image.reload()
        np.testing.assert_allclose(pixels(image), shown, atol=0.01)


def test_a_file_in_place_of_the_folder_is_reported(source, target, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    (tmp_path / "textures").write_bytes(b"")
    with pytest.raises(zo.MeshError, match="cannot be made: pack the images"):
        api.bake_textures(bpy.context, target, api.Baking(size=16, save=True))


def test_operator_bakes_textures(source, target):
    assert bpy.ops.zoomout.bake_textures(bake_size=16) == {"FINISHED"}
    assert bpy.data.images["Target Base Color"].size[:] == (16, 16)


def test_one_bake_is_one_undo_step(source, target):
    bpy.ops.ed.undo_push(message="Before")
    before = snapshot_file()
    assert bpy.ops.zoomout.bake_textures("EXEC_DEFAULT", True, bake_size=16) == {"FINISHED"}
    assert snapshot_file() != before
    bpy.ops.ed.undo()
    assert snapshot_file() == before


def test_tangent_spaces_are_those_of_blender(source):
    mesh = source.data
    mesh.calc_tangents(uvmap="UVMap")
    corners = len(mesh.loops)
    tangent, side = np.empty(3 * corners, np.float32), np.empty(corners, np.float32)
    mesh.loops.foreach_get("tangent", tangent)
    mesh.loops.foreach_get("bitangent_sign", side)
    uv = mesh_data.read_layer(mesh, "UVMap", mesh_data.Role.UV_MAP).attribute.values
    surface = mesh_data.read_surface_at_rest(source)
    found = tangent_space(surface, uv, mesh_data.read_own_normals(mesh).values)
    corner = surface.triangle_corners.ravel()
    agreement = np.einsum("cx,cx->c", found.tangent.reshape(-1, 3), tangent.reshape(-1, 3)[corner])
    assert (agreement > 0.999).mean() > 0.98
    assert (np.repeat(found.side, 3) == side[corner]).mean() > 0.99
