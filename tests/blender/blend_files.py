# SPDX-License-Identifier: GPL-3.0-or-later
"""A rigged character in a file, a scan of it in another, and the true map between their visible surfaces."""

import bpy
import numpy as np
from rigged import pose_target, source_and_rig
from scenes import activate, add_uv_map, ellipsoid, new_material, positions

import zoomout_core as zo
from blender_addon.services.transfer_files import read_file
from blender_addon.storage import stored_match
from zoomout_core.geometry.closest_points import closest_points

# Above the tube that is the body; loose, and on no rig.
PLACE_OF_EYE = (0, 0, 7)
PAINT = (0.2, 0.4, 0.6, 1.0)


def save(path):
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)


def write_pair(hero, scan):
    """Write both files, and return the rest positions of the scan's body.

    The hero is a rigged body with data of all sorts, and an eye. The scan has these two as well, in quads, with
    a subdivision surface, and a hidden object.
    """
    body, armature = source_and_rig()
    target, at_rest = pose_target(body, armature, name="Body")
    stored_match.remove(target.data)
    target.modifiers.new("Smooth", "SUBSURF")
    body.name = "Hero"
    _give_data(body)
    eye = ellipsoid("Eye", 3, (0.15, 0.1, 0.12))
    add_uv_map(eye.data, "Skin")
    own_eye, hidden = ellipsoid("Eyeball", 4, (0.15, 0.1, 0.12)), ellipsoid("Hidden", 3)
    eye.location = own_eye.location = PLACE_OF_EYE
    bpy.context.view_layer.update()
    hidden.hide_set(True)
    objects, own = bpy.context.scene.collection.objects, (target, own_eye, hidden)
    for obj in own:
        objects.unlink(obj)
    save(hero)
    for obj in (body, eye, armature):
        bpy.data.objects.remove(obj)
    for obj in own:
        objects.link(obj)
    hidden.hide_set(True)
    activate(target)
    bpy.data.orphans_purge()
    save(scan)
    return at_rest


def _give_data(body):
    """A UV map, a material, colours and a shape key."""
    mesh = body.data
    add_uv_map(mesh, "Skin")
    mesh.materials.append(new_material("Leather"))
    colors = mesh.color_attributes.new("Paint", "FLOAT_COLOR", "POINT")
    colors.data.foreach_set("color", np.tile(np.float32(PAINT), len(mesh.vertices)))
    body.shape_key_add(name="Basis")
    wide = positions(mesh) * np.float32((1.5, 1.5, 1))
    key = body.shape_key_add(name="Wide")
    key.points.foreach_set("co", wide.ravel())
    key.value = 0  # which it is not in all versions


def write_true_map(path, hero, scan, at_rest):
    """Write the map between two such files, whose objects may have been moved."""
    source = zo.Surface.joined(list(read_file(bpy.context, str(hero), "source").values()))
    surfaces = read_file(bpy.context, str(scan), "target")
    points = np.concatenate([at_rest if "Body" in name else each.vertices for name, each in surfaces.items()])
    found = zo.SurfaceMap(*closest_points(points, source.vertices, source.triangles), source.triangles)
    found.save(path, confidence=np.ones(len(points)))
