# SPDX-License-Identifier: GPL-3.0-or-later
"""Files as scenes: opening or importing them, appending meshes of another file, and writing them."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import addon_utils
import bpy
from bpy.types import ID, Context, Object

import zoomout_core as zo
from zoomout_core.mesh.formats.blender_files import BLEND, split_asset
from zoomout_core.mesh.formats.named_files import check_named_files
from zoomout_core.mesh.formats.opening import existing
from zoomout_core.runtime.outputs import atomic_write, atomic_write_together, is_same_file

from .. import mesh_data

# Kinds of assets, as in the paths of Blender's data.
COLLECTION, OBJECT = "Collection", "Object"
# Blender's add-ons that read and write formats.
ADDONS = {".glb": "io_scene_gltf2", ".gltf": "io_scene_gltf2", ".fbx": "io_scene_fbx"}


def _import_fbx(filepath: str) -> None:
    # Since 5.0, Blender's menus offer the importer in C++; before, it was experimental or missing.
    compiled = bpy.app.version >= (5, 0)
    (bpy.ops.wm.fbx_import if compiled else bpy.ops.import_scene.fbx)(filepath=filepath)


def _import_gltf(filepath: str) -> None:
    bpy.ops.import_scene.gltf(filepath=filepath, disable_bone_shape=True)  # exporters would write these meshes


IMPORTERS: dict[str, Callable[..., Any]] = {
    ".fbx": _import_fbx,
    ".glb": _import_gltf,
    ".gltf": _import_gltf,
    ".obj": lambda filepath: bpy.ops.wm.obj_import(filepath=filepath),
    ".ply": lambda filepath: bpy.ops.wm.ply_import(filepath=filepath),
    ".stl": lambda filepath: bpy.ops.wm.stl_import(filepath=filepath),
}
# Modifiers other than armatures are not exported: applying them would lose a mesh's shape keys. Armatures keep their
# bones: Blender would add one at the end of each chain.
EXPORTERS: dict[str, Callable[..., Any]] = {
    ".fbx": lambda filepath: bpy.ops.export_scene.fbx(
        filepath=filepath, path_mode="COPY", embed_textures=True, use_mesh_modifiers=False, add_leaf_bones=False
    ),
    ".glb": lambda filepath: bpy.ops.export_scene.gltf(filepath=filepath, export_format="GLB"),
    ".gltf": lambda filepath: bpy.ops.export_scene.gltf(filepath=filepath, export_format="GLTF_SEPARATE"),
    ".obj": lambda filepath: bpy.ops.wm.obj_export(filepath=filepath, path_mode="COPY", apply_modifiers=False),
    ".ply": lambda filepath: bpy.ops.wm.ply_export(filepath=filepath, apply_modifiers=False),
}
READABLE, WRITABLE = (BLEND, *IMPORTERS), (BLEND, *EXPORTERS)


def open_scene(context: Context, path: str | Path) -> None:
    """Open a file instead of the current one, or import it into an empty scene, without running its scripts.

    An asset in a .blend file (see `split_asset`) is appended to an empty scene, with its armatures and parents.

    Raises:
        MeshError: the file does not exist, its format is not supported, it cannot be read, or it has no such asset.
    """
    path, asset = split_asset(Path(path))
    _check_readable(path)
    ending = path.suffix.lower()
    try:
        if asset:
            open_empty_scene()
            append_assets(context, path, [asset])
        elif ending == BLEND:
            # With its windows, which determine the active scene and view layer.
            bpy.ops.wm.open_mainfile(filepath=str(path.resolve()), load_ui=True, use_scripts=False)
        else:
            open_empty_scene()
            _enable(ending)
            IMPORTERS[ending](filepath=str(path.resolve()))
    except (RuntimeError, OSError) as error:
        raise _cannot("open", path, error) from error
    active = context.view_layer.objects.active
    if active is not None and active.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    context.view_layer.update()


def open_empty_scene() -> None:
    """Open an empty scene instead of the current file."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


def append_file(context: Context, path: str | Path) -> list[Object]:
    """Append the objects of a file, or those of an asset in a .blend file, in a collection that is named after it.

    Args:
        context: Blender's.
        path: the file, or the asset, see `split_asset`.

    Raises:
        MeshError: the file does not exist, its format is not supported, it cannot be read, it is the open one, or it
            has no such asset.
    """
    file, asset = split_asset(Path(path))
    _check_readable(file)
    if bpy.data.filepath and is_same_file(file, bpy.data.filepath):
        raise zo.MeshError("{file} is the open file: choose one of its objects as the source.", file=file)
    ending = file.suffix.lower()
    before = {each.session_uid for each in bpy.data.objects}
    try:
        if asset:
            return append_assets(context, file, [asset])[asset]
        if ending == BLEND:
            with bpy.data.libraries.load(str(file.resolve()), link=False) as (there, wanted):
                wanted.objects = there.objects
        else:
            _enable(ending)
            IMPORTERS[ending](filepath=str(file.resolve()))
    except (RuntimeError, OSError) as error:
        raise _cannot("append", file, error) from error
    found = [obj for obj in bpy.data.objects if obj.session_uid not in before]
    collection = bpy.data.collections.new(file.stem)
    context.scene.collection.children.link(collection)
    for obj in found:
        for other in obj.users_collection:
            other.objects.unlink(obj)
        collection.objects.link(obj)
    context.view_layer.update()
    return found


def assets_of(path: Path) -> list[str]:
    """The collections and objects of a .blend file that are marked as assets, such as `Collection/Hero`.

    Raises:
        MeshError: the file does not exist, or cannot be read.
    """
    _check_readable(path)
    try:
        with bpy.data.libraries.load(str(path.resolve()), link=False, assets_only=True) as (there, _):
            named = [(COLLECTION, name) for name in there.collections] + [(OBJECT, name) for name in there.objects]
    except OSError as error:
        raise _cannot("open", path, error) from error
    return [f"{kind}/{name}" for kind, name in named]


def append_assets(context: Context, path: Path, names: Sequence[str]) -> dict[str, list[Object]]:
    """Append assets of a .blend file to the scene; armatures and parents of their objects are appended, too.

    Args:
        context: Blender's.
        path: the file.
        names: names of the assets, see `assets_of`.

    Returns:
        The own objects of each asset.

    Raises:
        MeshError: the file has no such asset.
        OSError: the file cannot be read.
    """
    kinds = [name.partition("/")[::2] for name in names]
    with bpy.data.libraries.load(str(path.resolve()), link=False) as (there, wanted):
        known = {COLLECTION: there.collections, OBJECT: there.objects}
        for kind, name in kinds:
            if name not in known.get(kind, ()):
                raise zo.MeshError("{path} has no asset '{name}': prepare the library again.", path=path, name=name)
        wanted.collections = [name for kind, name in kinds if kind == COLLECTION]
        wanted.objects = [name for kind, name in kinds if kind == OBJECT]
    collections, objects = iter(wanted.collections), iter(wanted.objects)
    found = {}
    for asset, (kind, name) in zip(names, kinds, strict=True):
        if kind == COLLECTION:
            root = collection = next(collections)
        else:
            root, collection = next(objects), bpy.data.collections.new(name)
            collection.objects.link(root)
        root.asset_clear()
        context.scene.collection.children.link(collection)
        found[asset] = list(collection.all_objects)
        posing = dict.fromkeys(each for obj in found[asset] for each in _posing(obj))
        for obj in posing.keys() - set(found[asset]):
            collection.objects.link(obj)
    context.view_layer.update()
    return found


def shown_meshes(objects: Iterable[Object]) -> list[str]:
    """Sorted names of the visible mesh objects with faces among some; of those that share a mesh, the first.

    Importing a file again may change the order of its objects, but not their names.
    """
    first: dict[Any, str] = {}
    for obj in sorted(objects, key=lambda each: each.name):
        if obj.type == "MESH" and obj.data.polygons and obj.visible_get():
            first.setdefault(obj.data, obj.name)
    return list(first.values())


@contextmanager
def keep_as_blend(path: str | Path) -> Iterator[Path]:
    """The .blend file of the open scene: the file at `path` itself, or a temporary one if that is no .blend file.

    Raises:
        RuntimeError: the temporary file could not be written.
    """
    if Path(path).suffix.lower() == BLEND and Path(path).is_file():
        yield Path(path)
        return
    with tempfile.TemporaryDirectory(prefix="zoomout-") as folder:
        kept = Path(folder) / f"scene{BLEND}"
        bpy.ops.wm.save_as_mainfile(filepath=str(kept), copy=True)
        yield kept


class Brought:
    """Mesh objects of another file, temporarily in the scene, with the data that they need.

    Args:
        context: Blender's.
        library: a .blend file.
        names: names of its objects.

    Attributes:
        names: names of the objects in the scene.

    Raises:
        MeshError: an object is linked into that file from another one.
    """

    def __init__(self, context: Context, library: Path, names: Sequence[str]) -> None:
        before = {each.session_uid for each in _all_data()}
        with bpy.data.libraries.load(str(library), link=False) as (_, wanted):
            wanted.objects = list(names)
        meshes = wanted.objects
        missing = [name for name, obj in zip(names, meshes, strict=True) if obj is None]
        if missing:
            raise zo.MeshError(f"'{missing[0]}' is linked into its file from another file: make it local there first.")
        self.names = [obj.name for obj in meshes]
        self._uids = {each.session_uid for each in _all_data()} - before
        for obj in dict.fromkeys([*meshes, *(each for mesh in meshes for each in _posing(mesh))]):
            context.scene.collection.objects.link(obj)
        context.view_layer.update()

    def remove(self, context: Context, users: Sequence[str]) -> None:
        """Remove the objects and the data that came with them, except data that others now use.

        Args:
            context: Blender's.
            users: names of objects of the scene, which keep the armatures that they were bound to.
        """
        for name in self.names:
            bpy.data.objects.remove(bpy.data.objects[name])
        posing = {each.session_uid for name in users for each in _posing(bpy.data.objects[name])}
        for obj in list(context.scene.collection.objects):
            if obj.session_uid in self._uids - posing:
                context.scene.collection.objects.unlink(obj)
        for each in _all_data():
            if each.session_uid in self._uids:
                each.use_fake_user = False
        # Data without users would not be saved in any case.
        bpy.data.orphans_purge(do_local_ids=True, do_linked_ids=True, do_recursive=True)
        for library in [each for each in bpy.data.libraries if not each.users_id]:
            bpy.data.libraries.remove(library)
        context.view_layer.update()


def save_scene(path: str | Path, inputs: Iterable[str | Path] = ()) -> None:
    """Save or export the open scene by the extension of a path, completely or not at all.

    Args:
        path: the file to write; an export writes images and materials beside it.
        inputs: files that must not be replaced by these.

    Raises:
        MeshError: the extension is not supported.
        OutputError: the file could not be written, or would replace an input; earlier files are unchanged.
    """
    check_writable_format(path)
    ending = Path(path).suffix.lower()
    if ending == BLEND:
        with atomic_write(path) as part:
            bpy.ops.wm.save_as_mainfile(filepath=str(part), copy=True)
        return
    _enable(ending)
    with atomic_write_together(path, inputs) as part:
        EXPORTERS[ending](filepath=str(part))


def check_writable_format(path: str | Path) -> None:
    """Raise a MeshError if the extension of a path is not supported for writing."""
    if Path(path).suffix.lower() not in WRITABLE:
        raise zo.MeshError(f"{path} has no supported file extension: use {', '.join(WRITABLE)}.")


def _check_readable(path: str | Path) -> Path:
    """The path of a file that Blender may read.

    Raises:
        MeshError: the file does not exist, or its format is not supported.
    """
    path = existing(path)
    if path.suffix.lower() not in READABLE:
        raise zo.MeshError(f"The format of {path} is not supported: convert it to {', '.join(READABLE)}.")
    check_named_files(path)  # importers would read them anywhere
    return path


def _enable(ending: str) -> None:
    """Turn on the Blender add-on that a format needs, for this session."""
    if ending in ADDONS:
        addon_utils.enable(ADDONS[ending])


def _posing(obj: Object) -> list[Object]:
    """The armatures and the parent of an object, with all their ancestors."""
    found: dict[Object, None] = {}
    ahead = [*mesh_data.armatures_of(obj), obj.parent]
    while ahead:
        other = ahead.pop()
        if other is not None and other not in found:
            found[other] = None
            ahead.append(other.parent)
    return list(found)


def _all_data() -> Iterator[ID]:
    """All data-blocks of the file."""
    for each in bpy.data.bl_rna.properties:
        if each.type == "COLLECTION":
            yield from getattr(bpy.data, each.identifier)


def _cannot(do: str, path: Path, error: Exception) -> zo.MeshError:
    """The error of a file that Blender could not open or append."""
    return zo.MeshError(
        f"Blender could not {do} {path} ({_reason(error)}): check that the file is complete and has the right "
        "extension."
    )


def _reason(error: Exception) -> str:
    """The error of one of Blender's operators, as a part of a sentence."""
    return " ".join(str(error).split()).removeprefix("Error: ").rstrip(".")
