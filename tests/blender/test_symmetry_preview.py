# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours over the object show a symmetry, its sides and asymmetries."""

import re
from dataclasses import replace

import bpy
import numpy as np
import pytest
from scenes import set_weights, snapshot
from symmetric import BENT, LEFT, RIGHT, X, add_key, bumps

import zoomout_core as zo
from blender_addon import jobs
from blender_addon.colors import PALENESS, asymmetry_colors, pair_colors
from blender_addon.colors import SIDES as SIDE_COLORS
from blender_addon.scene import mesh_facts
from blender_addon.services.preflight import is_reshaped
from blender_addon.services.symmetry.check import check_symmetry, measure_asymmetry
from blender_addon.services.symmetry.detect import choose_symmetry, detect_symmetry
from blender_addon.services.symmetry.weights import symmetrise_weights
from blender_addon.storage import stored_symmetry
from blender_addon.ui import thumbnails
from blender_addon.viewport import overlay, preview
from zoomout_core.colors import place_colors
from zoomout_core.symmetry.self_map import SelfMap

# An arbitrary vertex for each.
ANY = np.random.default_rng(0).permutation(len(X))


def colors():
    """The colours of the single coloured object."""
    (one,) = overlay.overlays()
    return one.values


def test_previews_show_the_symmetry_without_changing_the_file(body):
    before = snapshot(body)
    assert bpy.ops.zoomout.preview(kind="PAIRS") == {"FINISHED"}
    images = stored_symmetry.read(body).surface_map.vertex
    paler = (colors() - PALENESS) / (1 - PALENESS)  # the right side without its white
    assert np.abs(paler[RIGHT] - colors()[images][RIGHT]).mean() < 0.02
    assert np.ptp(colors()[LEFT], axis=0).min() > 0.3
    bpy.context.scene.zoomout.symmetry.middle_width = 0.02
    assert bpy.ops.zoomout.preview(kind="SIDES") == {"FINISHED"}
    side = stored_symmetry.read(body).sides(0.02 * np.sqrt(BENT.surface.area))
    for number, color in zip((1, -1, 0), (SIDE_COLORS[2], SIDE_COLORS[0], SIDE_COLORS[1]), strict=True):
        np.testing.assert_allclose(colors()[side == number], np.broadcast_to(color, (np.sum(side == number), 3)))
    check_symmetry(bpy.context, body, "shape")
    legend = preview.preview_of(body).legend
    assert legend.startswith("Shape: the sides differ by ")
    lengths = re.findall(r"\d[\d.]*", legend)
    assert len(lengths) == 3
    assert all(len(length.replace(".", "").strip("0")) <= 2 for length in lengths)  # significant digits only
    assert bpy.ops.zoomout.clear_preview() == {"FINISHED"}
    assert (snapshot(body), overlay.overlays()) == (before, ())


def test_new_symmetry_is_shown_until_the_selection_changes(body):
    assert bpy.ops.zoomout.detect_symmetry() == {"FINISHED"}
    assert preview.preview_of(body).kind == "PAIRS"
    assert bpy.ops.zoomout.swap_sides() == {"FINISHED"}
    assert preview.current().passing
    bpy.context.view_layer.objects.active = None
    preview.follow_selection()
    assert preview.current() is None
    detect_symmetry(bpy.context, body)  # a script shows nothing
    assert preview.current() is None


def test_red_means_the_same_in_every_check(body):
    for slope in (0.1, 0.4):
        set_weights(body, "Arm.L", 0.5 + slope * X)
        assert check_symmetry(bpy.context, body, "weights", red_weight=0.8).endswith("red is 80% and more")
        values = jobs.run(measure_asymmetry(bpy.context, body.name, "weights"))
        np.testing.assert_allclose(colors(), asymmetry_colors(values, 0.8), atol=1e-6)


def test_lengths_use_the_units_of_the_scene(body):
    red = check_symmetry(bpy.context, body, "shape", red_length=0.1).split("red is ")[1]
    assert re.fullmatch(r"[\d.]+ cm and more", red)
    assert check_symmetry(bpy.context, body, "shape", red_length=0.2).split("red is ")[1] != red
    bpy.context.scene.unit_settings.scale_length = 0.001
    assert (
        check_symmetry(bpy.context, body, "shape", red_length=0.1).split("red is ")[1]
        == f"{float(red.split()[0]) / 100} mm and more"
    )
    body.scale = (2, 2, 2)
    bpy.context.view_layer.update()
    twice = check_symmetry(bpy.context, body, "shape", red_length=0.1).split("red is ")[1]
    assert float(twice.split()[0]) == pytest.approx(2 * float(red.split()[0]) / 100, rel=0.1)


def test_other_symmetries_swapped_sides_and_undo_are_shown(body, found):
    turn = replace(found[0], distance=np.zeros(len(X)), surface_map=zo.SurfaceMap.from_vertices(ANY, BENT.surface))
    stored_symmetry.write(body, (found[0], turn), "X")
    bpy.ops.zoomout.preview(kind="SIDES")
    bpy.ops.ed.undo_push(message="Shown")
    first = colors()
    bpy.ops.zoomout.swap_sides()
    bpy.ops.ed.undo_push(message="Swapped")
    assert (colors()[LEFT] == first[RIGHT][0]).all(axis=1).mean() > 0.9
    bpy.ops.ed.undo()
    np.testing.assert_array_equal(colors(), first)
    body = bpy.data.objects["Creature"]
    choose_symmetry(bpy.context, body, 1)
    assert preview.preview_of(body).kind == "PAIRS"  # there are no sides
    images = stored_symmetry.read(body).surface_map.interpolate(BENT.surface.vertices)
    farthest = np.fmax(images, BENT.surface.vertices)
    np.testing.assert_allclose(colors(), place_colors(farthest, BENT.surface.vertices), atol=1e-5)
    detect_symmetry(bpy.context, body)
    assert np.abs(colors()[RIGHT].min(axis=1)).min() > PALENESS


def test_higher_order_symmetry_colours_orbits_alike():
    turns = np.arange(10) * np.pi / 5
    points = np.concatenate([[np.cos(turns), np.sin(turns), np.zeros(10)], np.zeros((3, 1))], axis=1).T
    points[10, 2] = 1
    surface = zo.Surface(points, [[i, (i + 1) % 10, 10] for i in range(10)])
    fifth = zo.SurfaceMap.from_vertices(np.append((np.arange(10) + 2) % 10, 10), surface)
    star = SelfMap(
        surface=surface,
        surface_map=fifth,
        confidence=np.ones(11),
        reverses_orientation=False,
        distance=np.zeros(11),
    )
    shown = pair_colors(star, 5)
    np.testing.assert_allclose(shown[:10:2], np.broadcast_to(shown[0], (5, 3)), atol=1e-9)
    np.testing.assert_allclose(shown[1:10:2], np.broadcast_to(shown[1], (5, 3)), atol=1e-9)


def test_pictures_show_the_candidates(body, found):
    stored_symmetry.write(body, (found[0], found[0]), "X")
    pictures = stored_symmetry.thumbnails(stored_symmetry.description(body.data))
    assert len({name for name, _, _ in pictures}) == 2
    for _, points, shown in pictures:
        picture = thumbnails.picture(points, shown / 255)
        assert 0.05 < (picture[..., 3] > 0).mean() < 0.6
    assert len(body.data[stored_symmetry.PROPERTY]) < 30_000


def test_reshaped_mesh_is_detected_while_drawing(body):
    kept = stored_symmetry.description(body.data)
    for moved in (0, 0.1):
        body.data.vertices[0].co.x += moved
        body.data.update_tag()
        bpy.context.view_layer.update()
        is_reshaped(body, kept)
        mesh_facts.inspect_now()
        assert is_reshaped(body, kept) == bool(moved)


def test_weights_check_requires_vertex_groups(body):
    for work in (lambda: check_symmetry(bpy.context, body, "weights"), lambda: symmetrise_weights(bpy.context, body)):
        with pytest.raises(zo.MeshError, match="'Creature' has no vertex groups: add some"):
            work()


def test_asymmetry_is_coloured_and_reported(body):
    set_weights(body, "Arm.L", np.clip(X, 0, 1))
    assert bpy.ops.zoomout.check_symmetry(check="WEIGHTS", red_weight=0.4) == {"FINISHED"}
    red, blue = colors()[:, 0], colors()[:, 2]
    assert (red > blue)[np.abs(X) > 0.8].mean() > 0.9
    assert (red < blue)[np.abs(X) < 0.1].mean() > 0.9
    assert preview.preview_of(body).legend.startswith("Weights: the sides differ by ")
    symmetrise_weights(bpy.context, body)
    bpy.context.view_layer.update()
    assert (overlay.overlays(), preview.preview_of(body).legend) == ((), preview.OUTDATED)
    check_symmetry(bpy.context, body, "weights")
    bpy.context.view_layer.update()
    red, blue = colors()[:, 0], colors()[:, 2]
    assert (red < blue).mean() > 0.9
    add_key(body, "Smile.L", bumps(np.clip(X, 0, 1)))
    add_key(body, "Smile.R", bumps(np.clip(-X, 0, 1)))
    bpy.context.scene.unit_settings.system = "NONE"
    like = check_symmetry(bpy.context, body, "key", "Smile.L")
    add_key(body, "Frown.L", bumps(np.clip(X, 0, 1)))
    unlike = check_symmetry(bpy.context, body, "key", "Frown.L")
    mean_of = [float(text.split(" differ by ")[1].split(" ")[0]) for text in (like, unlike)]
    assert mean_of[0] < 0.1 * mean_of[1]
    with pytest.raises(zo.MeshError, match="No shape key of 'Creature' is active"):
        check_symmetry(bpy.context, body, "key")
    with pytest.raises(zo.MeshError, match="no shape key 'Basis' besides the Basis"):
        check_symmetry(bpy.context, body, "key", "Basis")
