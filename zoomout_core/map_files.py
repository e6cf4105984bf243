# SPDX-License-Identifier: GPL-3.0-or-later
"""Map files of `zoomout match` and `zoomout symmetry`, and of commands that fail after a match."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import mkdtemp

from zoomout_core.assets.files import inputs_of
from zoomout_core.maps.surface_map import SurfaceMap
from zoomout_core.matching.result import MatchResult
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.surface import Surface
from zoomout_core.messages import NO_MEMORY, message_of
from zoomout_core.runtime.outputs import check_output


def check_map_output(path: str, inputs: Iterable[str], in_place: bool = False) -> None:
    """Check that a map can be written to a path, before it is computed.

    Raises:
        OutputError: the folder is missing or cannot be written to, or the file is an input or named by one.
        MeshError: the path does not end in .npz.
    """
    check_output(path, inputs_of(*inputs), in_place)
    if Path(path).suffix != ".npz":
        raise MeshError(f"{path} does not end in .npz: maps are written to .npz files only.")


def read_surface_map(path: str, source: Surface, target: Surface) -> SurfaceMap:
    """The map from `target` to `source` in a file that `match` wrote.

    Raises:
        MeshError: the file is not from `match`, or the map is between other surfaces.
    """
    surface_map = SurfaceMap.load(path, source)
    if len(surface_map.triangle) != len(target.vertices):
        raise MeshError(
            f"{path} maps {len(surface_map.triangle):,} vertices, but the target has {len(target.vertices):,}: give "
            "the two meshes of the map, in the same order."
        )
    return surface_map


def save_match(result: MatchResult, path: Path) -> None:
    """Write the map of a match with what belongs to it.

    Raises:
        OutputError: it cannot be written.
    """
    result.surface_map.save(
        path,
        confidence=result.confidence,
        functional_map=result.functional_map,
        has_partner=result.has_partner,
        source_has_partner=result.source_has_partner,
    )


@contextmanager
def keep_map(save: Callable[[Path], None], output: Path, use: str = " (--initial starts from it)") -> Iterator[None]:
    """A context of the work that follows a match: if it fails, the map is kept, and the message says where.

    Args:
        save: writes the map.
        output: the file that the command was to write; the map is put beside it, else into a new temporary folder.
        use: how the map can be used.

    Raises:
        MeshError: the work failed.
    """
    try:
        yield
    except Exception as error:  # whatever it is, the match has taken longest
        reason = message_of(error) if isinstance(error, ValueError | OSError | ImportError) else ""
        if not reason:
            kind = " ".join(f"{type(error).__name__}: {error}".split())
            reason = NO_MEMORY if isinstance(error, MemoryError) else f"It failed unexpectedly ({kind})."
        folders: list[Callable[[], Path]] = [lambda: output.parent, lambda: Path(mkdtemp(prefix="zoomout-"))]
        for folder_of in folders:
            with suppress(OSError):  # as the output, perhaps
                path = _free_path(folder_of(), output.stem)
                save(path)
                raise MeshError(f"{reason} The map was kept in {path}{use}.") from error
        raise


def _free_path(folder: Path, stem: str) -> Path:
    """The path of a map file that does not exist yet."""
    paths = (folder / f"{stem}_map{number or ''}.npz" for number in range(10_000))
    return next((path for path in paths if not path.exists()), folder / f"{stem}_map.npz")
