# SPDX-License-Identifier: GPL-3.0-or-later
"""The only package that converts between Blender's meshes and arrays.

Whole arrays are read and written by `foreach_get` and `foreach_set`. Names are imported on first use.
"""

from typing import TYPE_CHECKING

from zoomout_core.runtime.first_use import imports_on_first_use

if TYPE_CHECKING:
    from .attributes.layers import (
        HAS_PARTNER,
        MATCH_ATTRIBUTES,
        MAX_UV_MAPS,
        SCULPTED,
        SYMMETRY_ATTRIBUTES,
        ActiveLayers,
        Layer,
        Role,
        count_layers,
        fits,
        read_active_layers,
        read_layer,
        read_layers,
        untransferable_data,
        write_active_layers,
        write_layer,
    )
    from .attributes.marks import MARKS, SEAMS, read_marks, write_marks
    from .attributes.materials import read_materials, write_materials
    from .attributes.normals import read_normals, read_own_normals, write_custom_normals
    from .attributes.selection import read_selection, select_only, write_selection
    from .attributes.vertex_groups import (
        deforming_bones,
        locked_groups,
        read_mask,
        read_weights,
        read_weights_in_pieces,
        update_weights,
        write_weights,
    )
    from .keys.body_keys import BodyKeys, read_body_keys, write_body_keys
    from .keys.key_drivers import Partners, Redirected, bones_of_drivers, partner_armatures, redirect_drivers
    from .keys.shape_keys import (
        ShapeKey,
        ShapeKeys,
        join_shape_keys,
        names_of_keys,
        offsets_of,
        read_full_offsets,
        read_key_positions,
        read_own_shape_keys,
        read_rest_positions,
        read_shape_keys,
        read_undeformed_positions,
    )
    from .keys.write_keys import move_vertices, rename_shape_keys, write_animation, write_shape, write_shape_keys
    from .objects.cutting import divide, write_divided
    from .objects.levels import DetailedMesh, add_level, read_detailed_mesh, read_given_level
    from .objects.live_link import NODE_TYPES, LinkedLayer, link_modifier, remove_link, write_link
    from .objects.shaped_copy import add_shaped_copy
    from .objects.strands import attach_strands
    from .objects.text import text_triangles
    from .objects.worn import (
        Worn,
        add_worn_copy,
        bind_worn_copy,
        collection_beside,
        content_of,
        dress_name,
        groups_to_keep,
        is_worn_copy,
        kept_group,
        original_name,
        read_worn,
        worn_copies,
        worn_copies_in,
    )
    from .rigs.animation import (
        HeldKeys,
        HeldPose,
        follow_constraints,
        frames_of_animation,
        moves_by_itself,
        read_animation,
        turn_bones,
    )
    from .rigs.armatures import (
        Bones,
        armatures_of,
        bind_like,
        can_be_put,
        place_beside,
        preserves_volume,
        read_bones,
        reshape,
        stands_as_modelled,
        unbind,
    )
    from .rigs.metarigs import copy_loose_rig, copy_metarig, metarig_of
    from .rigs.moved_rig import RigBones, bends_at_rest, child_of_constraints, copy_rig, read_rig_bones
    from .rigs.outfit_bones import OutfitBones, add_outfit_bones, bind_to_other, bones_copied_from, read_outfit_bones
    from .surfaces.base_mesh import (
        base_mesh,
        is_cage,
        read_mirrored_surface,
        read_target_faces,
        read_target_surface,
        values_through_modifiers,
    )
    from .surfaces.inspection import MeshFacts, content_hash, inspect_mesh
    from .surfaces.intersections import intersecting_triangles
    from .surfaces.joined import (
        EvaluatedObject,
        JoinedLayer,
        read_joined_active_layers,
        read_joined_active_uv_map,
        read_joined_at_rest,
        read_joined_layers,
        read_joined_marks,
        read_joined_materials,
        read_joined_normals,
        read_joined_uv,
        read_joined_weights,
    )
    from .surfaces.object_pair import Fingerprint, ObjectPair
    from .surfaces.surface_points import (
        SurfacePoint,
        extent,
        nearest_surface_point,
        raycast_surface_point,
        surface_point_in_face,
        surface_point_of_vertex,
    )
    from .surfaces.surfaces import (
        Faces,
        area_in_world,
        directions_in_world,
        evaluated_mesh,
        is_disabled,
        is_flat,
        is_mirrored,
        origin,
        positions_in_object,
        positions_in_world,
        read_faces,
        read_positions,
        read_source_faces,
        read_source_surface,
        read_surface_at_rest,
        to_object,
        without_faces,
    )
    from .textures.image_nodes import ImageRole, ImageUse, copy_with_images, read_image_uses
    from .textures.images import ImageFormat, folder_error, move_images, read_tiles, write_image
    from .writing import Writing, all_or_nothing

if not TYPE_CHECKING:  # so that type checkers report unknown names
    __getattr__ = imports_on_first_use(__name__, __file__)
