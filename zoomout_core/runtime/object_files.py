# SPDX-License-Identifier: GPL-3.0-or-later
"""Store trees of dataclasses in .npz files: plain arrays and one JSON text, so that no code in a file can run.

An object that occurs several times in a tree is stored once, and is one object again after reading.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from hashlib import sha256
from os import PathLike
from typing import Any, TypeAlias

import numpy as np
from scipy.sparse import csc_array

from zoomout_core.runtime.array_files import ArrayFileError, read_arrays, write_arrays
from zoomout_core.runtime.outputs import atomic_write

TREE, CHECKSUM = "tree", "checksum"
SPARSE = "data", "indices", "indptr"
# The classes that a file may contain, and the stored attributes of each.
Classes: TypeAlias = Mapping[type, Sequence[str]]


def fields_of(*classes: type) -> dict[type, tuple[str, ...]]:
    """The fields of some dataclasses."""
    return {each: tuple(field.name for field in fields(each)) for each in classes}


def save_object(path: str | PathLike[str], value: object, classes: Classes) -> None:
    """Write an object of one of the classes and everything that it refers to, completely or not at all.

    Attributes are numbers, strings, arrays, sparse matrices, tuples, lists, dictionaries with strings as keys, and
    objects of these classes.

    Raises:
        OutputError: the file cannot be written.
    """
    writer = _Writer(classes)
    tree = {"root": writer.encode(value), "objects": writer.objects}
    arrays = {f"array {number}": array for number, array in enumerate(writer.arrays)}
    arrays[TREE] = np.frombuffer(json.dumps(tree).encode(), np.uint8)
    with atomic_write(path) as part:
        write_arrays(part, arrays | {CHECKSUM: _checksum(arrays)}, compressed=False)


def load_object(path: str | PathLike[str], classes: Classes) -> Any:
    """Read an object that `save_object` wrote; only these classes are accepted.

    Raises:
        FileNotFoundError: the file is missing.
        ArrayFileError: it has another format, is broken, was changed, or contains another class.
    """
    arrays = read_arrays(path)
    try:
        if not np.array_equal(arrays.pop(CHECKSUM), _checksum(arrays)):
            raise ArrayFileError("its arrays were changed after it was saved")
        tree = json.loads(arrays[TREE].tobytes())
        return _Reader(tree["objects"], arrays, classes).decode(tree["root"])
    except ArrayFileError:
        raise
    except Exception as error:  # the type of the error depends on which parts do not fit together
        raise ArrayFileError("it is damaged, or was saved by another version") from error


def _checksum(arrays: Mapping[str, np.ndarray[Any, Any]]) -> np.ndarray[Any, Any]:
    """A hash of some arrays, since those of an object must fit together in more ways than are worth checking."""
    found = sha256()
    for name in sorted(arrays):
        array = arrays[name]
        found.update(repr((name, array.dtype.str, array.shape)).encode())
        found.update(np.ascontiguousarray(array).data.cast("B") if array.size else b"")
    return np.frombuffer(found.digest(), np.uint8)


class _Writer:
    """Numbers objects and arrays in the order of their first occurrence."""

    def __init__(self, classes: Classes) -> None:
        self.objects: list[Any] = []
        self.arrays: list[np.ndarray[Any, Any]] = []
        self._classes = classes
        # By id; objects are kept alive, so that no id is reused.
        self._numbers: dict[int, tuple[object, int]] = {}

    def encode(self, value: object) -> Any:
        if value is None or isinstance(value, bool | int | float | str):
            return value
        if isinstance(value, np.generic):
            return value.item()
        if isinstance(value, np.ndarray):
            return {"array": self._number(value, self.arrays, lambda array: array)}
        if isinstance(value, csc_array):
            return {"object": self._number(value, self.objects, self._sparse)}
        if isinstance(value, dict):
            return {"dict": {key: self.encode(each) for key, each in value.items()}}
        if type(value) in (tuple, list):
            return {type(value).__name__: [self.encode(each) for each in value]}  # type: ignore[attr-defined]
        return {"object": self._number(value, self.objects, self._instance)}

    def _number(self, value: Any, store: list[Any], make: Callable[[Any], Any]) -> int:
        if id(value) not in self._numbers:
            self._numbers[id(value)] = value, len(store)
            store.append(None)
            number = len(store) - 1
            store[number] = make(value)
        return self._numbers[id(value)][1]

    def _sparse(self, matrix: csc_array) -> Any:
        parts = [self.encode(getattr(matrix, name)) for name in SPARSE]
        return {"class": csc_array.__name__, "parts": parts, "shape": list(matrix.shape)}

    def _instance(self, value: Any) -> Any:
        names = self._classes[type(value)]
        return {"class": type(value).__name__, "fields": {name: self.encode(getattr(value, name)) for name in names}}


class _Reader:
    """Creates each object of a tree once."""

    def __init__(self, objects: list[Any], arrays: dict[str, Any], classes: Classes) -> None:
        self._objects, self._arrays, self._made = objects, arrays, dict[int, Any]()
        self._classes = {each.__name__: (each, names) for each, names in classes.items()}

    def decode(self, tree: Any) -> Any:
        if not isinstance(tree, dict):
            return tree
        ((kind, content),) = tree.items()
        if kind == "array":
            return self._arrays[f"array {content}"]
        if kind == "dict":
            return {key: self.decode(each) for key, each in content.items()}
        if kind in ("tuple", "list"):
            return (tuple if kind == "tuple" else list)(self.decode(each) for each in content)
        if content not in self._made:
            self._made[content] = self._object(self._objects[content])
        return self._made[content]

    def _object(self, stored: Any) -> Any:
        if stored["class"] == csc_array.__name__:
            matrix = csc_array(tuple(self.decode(part) for part in stored["parts"]), shape=tuple(stored["shape"]))
            matrix.check_format(full_check=True)  # or compiled code could read beyond its arrays
            return matrix
        made, names = self._classes[stored["class"]]
        value: Any = object.__new__(made)
        for name in names:
            object.__setattr__(value, name, self.decode(stored["fields"][name]))
        return value
