# SPDX-License-Identifier: GPL-3.0-or-later
"""The packages of the core import each other in one direction only, as ARCHITECTURE.md says."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import zoomout_core

CORE = Path(zoomout_core.__file__).parent
DOCUMENT = (CORE.parent / "ARCHITECTURE.md").read_text(encoding="utf-8")
PACKAGES = ("zoomout_core", "blender_addon", "meshlab_filter", "benchmarks", "tests", "docs")
# Each may import those before it.
LAYERS = (
    "arrays",
    "messages",
    "translations",
    "tuning",
    "mesh",
    "geometry",
    "spectral",
    "maps",
    "transfer",
    "assets",
    "matching",
    "symmetry",
    "evaluation",
    "colors",
    "drawing",
    "expression_sheet",
    "plotting",
    "samples",
    "collection",
    "outfits",
    "library",
)
# Every package may import it; it imports none of them.
RUNTIME = "runtime"


def imports(path: Path) -> Iterator[str]:
    """Names of the core's modules that a module imports, also while it runs."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("zoomout_core."):
            yield str(node.module)
        elif isinstance(node, ast.Import):
            yield from (name.name for name in node.names if name.name.startswith("zoomout_core."))
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            names = (name.value for name in node.args if isinstance(name, ast.Constant))
            yield from (str(name) for name in names if str(name).startswith("zoomout_core."))


def test_layers_import_only_earlier_layers() -> None:
    modules = {path: path.relative_to(CORE).with_suffix("").parts[0] for path in CORE.rglob("*.py")}
    assert set(LAYERS) <= set(modules.values())
    wrong = [
        f"{path.relative_to(CORE)} imports {module}"
        for path, layer in modules.items()
        if layer in (*LAYERS, RUNTIME)
        for module in imports(path)
        if (other := module.split(".")[1]) != layer and not allowed(layer, other)
    ]
    assert not wrong


def allowed(layer: str, other: str) -> bool:
    """Whether one package may import another."""
    if layer == RUNTIME:
        return False
    if layer == "matching" and other in ("transfer", "assets"):
        return False
    return other == RUNTIME or (other in LAYERS and LAYERS.index(other) < LAYERS.index(layer))


def defined_names(tree: ast.Module) -> set[str]:
    """Names that the functions, classes and assignments of a module define."""
    definitions = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    names = {node.name for node in ast.walk(tree) if isinstance(node, definitions)}
    return names | {
        node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    }


def test_names_are_imported_from_the_modules_that_define_them() -> None:
    trees = {
        path.relative_to(CORE.parent).with_suffix("").parts: ast.parse(path.read_text(encoding="utf-8"))
        for package in PACKAGES
        for path in (CORE.parent / package).rglob("*.py")
        if path.name != "__main__.py"
    }
    defined = {module: defined_names(tree) for module, tree in trees.items() if module[-1] != "__init__"}
    wrong = [
        f"{'.'.join(module)} imports {name.name} from {'.'.join(home)}"
        for module, tree in trees.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module
        for home in [(*(module[: -node.level] if node.level else ()), *node.module.split("."))]
        for name in node.names
        if home in defined and name.name not in defined[home]
    ]
    assert not wrong


def rows_of_the_document() -> list[list[str]]:
    """The names in each row of the table of the core's packages."""
    table = DOCUMENT.split("| `zoomout_core/` | contents |")[1].split("\n\n")[0]
    return [re.findall(r"`(\w+)/?`", line.split("|")[1]) for line in table.splitlines()[2:]]


def test_the_document_lists_all_packages_in_the_order_of_their_imports() -> None:
    row_of = {name: row for row, names in enumerate(rows_of_the_document()) for name in names}
    modules = {path: path.relative_to(CORE).with_suffix("").parts[0] for path in CORE.rglob("*.py")}
    assert set(row_of) == set(modules.values()) - {"__init__"}
    wrong = [
        f"{path.relative_to(CORE)} imports {module}"
        for path, name in modules.items()
        if name in row_of
        for module in imports(path)
        if row_of[module.split(".")[1]] > row_of[name]
    ]
    assert not wrong


def find_path(path: str) -> list[Path]:
    """The files and folders of the packages that a path, or the end of one, names."""
    roots = [CORE.parent / package for package in PACKAGES]
    found = [CORE.parent / path] + [each for root in roots for each in root.rglob(path.rstrip("/"))]
    return [each for each in found if each.exists()]


def test_paths_in_the_document_exist() -> None:
    paths = {path for path in re.findall(r"`([\w./]+)`", DOCUMENT) if re.search(r"/|\.(py|md|po)$", path)}
    assert len(paths) > 100
    assert [path for path in sorted(paths) if not find_path(path)] == []


def test_names_in_the_document_are_defined_in_the_files_that_it_says() -> None:
    named = re.findall(r"`(\w+)` in `([\w/]+\.py)`", DOCUMENT)
    assert len(named) > 10
    wrong = [
        f"{name} in {path}"
        for name, path in named
        if not any(
            re.search(rf"(?m)^ *(async )?(def |class )?{name}\b", each.read_text("utf-8")) for each in find_path(path)
        )
    ]
    assert not wrong


def test_core_imports_neither_blender_nor_meshlab() -> None:
    packages = ("blender_addon", "meshlab_filter")
    for path in CORE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [name.name for name in node.names] if isinstance(node, ast.Import) else []
            assert not [name for name in names if name.split(".")[0] in ("bpy", "pymeshlab", *packages)], path
            assert not isinstance(node, ast.Constant) or node.value not in packages, path
