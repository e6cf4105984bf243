# SPDX-License-Identifier: GPL-3.0-or-later
# Lists the content of GLB files as the editor of the game engine Godot 3 imports them, as JSON:
# godot3-server -s godot.gd FILE...
extends SceneTree


func _init():
	var found = []
	for path in OS.get_cmdline_args():
		if path.ends_with(".glb"):
			found.append(read(path))
	print(to_json(found))
	quit()


func read(path):
	var row = {"file": path.get_file(), "reader": "Godot"}
	var root = PackedSceneGLTF.new().import_gltf_scene(path)
	if root == null:
		row["problem"] = "not imported"
		return row
	var sums = {"names": [], "vertices": 0, "triangles": 0, "joints": 0, "targets": []}
	add_meshes(root, sums)
	root.free()
	for key in sums:
		row[key] = sums[key]
	return row


func add_meshes(node, row):
	if node is MeshInstance and node.skin != null:
		row["names"].append(node.name)
		row["joints"] += node.skin.get_bind_count()
		for key in node.mesh.get_blend_shape_count():
			row["targets"].append(node.mesh.get_blend_shape_name(key))
		for surface in node.mesh.get_surface_count():
			var arrays = node.mesh.surface_get_arrays(surface)
			row["vertices"] += arrays[Mesh.ARRAY_VERTEX].size()
			row["triangles"] += arrays[Mesh.ARRAY_INDEX].size() / 3
			check_weights(arrays[Mesh.ARRAY_WEIGHTS], row)
	for child in node.get_children():
		add_meshes(child, row)


func check_weights(weights, row):
	for vertex in weights.size() / 4:
		var sum = 0.0
		for place in 4:
			sum += weights[4 * vertex + place]
		if abs(sum - 1) > 0.001:
			row["problem"] = "weights do not sum to one"
