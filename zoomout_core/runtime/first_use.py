# SPDX-License-Identifier: GPL-3.0-or-later
"""Packages that import their modules on first use, so that programs start without waiting for unused modules.

The package declares its imports under `TYPE_CHECKING`, for type checkers and readers, and one of these functions
returns its `__getattr__` (PEP 562). `import scipy` works in the same way.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType


def names_on_first_use(package: str, homes: Mapping[str, Sequence[str]]) -> Callable[[str], object]:
    """A `__getattr__` that imports a name from its module; `homes` lists the names by the paths of their modules."""
    home = {name: path for path, names in homes.items() for name in names}

    def import_name(name: str) -> object:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(f"{package}.{home[name]}"), name)
        setattr(sys.modules[package], name, value)
        return value

    return import_name


def imports_on_first_use(package: str, file: str) -> Callable[[str], object]:
    """A `__getattr__` that imports a name from the module that the package's imports under `TYPE_CHECKING` say.

    It reads the source file of the package. Packages that may be installed without sources, as by PyInstaller, use
    `names_on_first_use` instead.
    """
    statements = ast.parse(Path(file).read_text(encoding="utf-8")).body
    block = next(each for each in statements if isinstance(each, ast.If) and ast.unparse(each.test) == "TYPE_CHECKING")
    homes = {
        str(node.module): [name.name for name in node.names] for node in block.body if isinstance(node, ast.ImportFrom)
    }
    return names_on_first_use(package, homes)


def modules_on_first_use(package: str) -> Callable[[str], ModuleType]:
    """A `__getattr__` that imports the modules of a package."""

    def import_submodule(name: str) -> ModuleType:
        path = f"{package}.{name}"
        if name.startswith("__") or find_spec(path) is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return import_module(path)

    return import_submodule
