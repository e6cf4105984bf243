# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole arrays of properties of a mesh's elements, and small arrays as text, for custom properties."""

from __future__ import annotations

import base64
import hashlib
from typing import Any

import numpy as np
from numpy.typing import DTypeLike


def read_array(elements: Any, name: str, dtype: DTypeLike, width: int = 1) -> np.ndarray:
    """(count,) or, for a width above one, (count, width) values of a property of all elements."""
    values = np.empty(len(elements) * width, dtype)
    elements.foreach_get(name, values)
    return values if width == 1 else values.reshape(-1, width)


def hash_of(words: str, *arrays: np.ndarray) -> str:
    """A hash of some words and of arrays, including their types and shapes."""
    digest = hashlib.blake2b(words.encode(), digest_size=16)
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def to_text(array: np.ndarray, dtype: DTypeLike) -> str:
    """Encode an array's values, converted to a type, as text."""
    return base64.b64encode(np.ascontiguousarray(array, dtype).tobytes()).decode()


def from_text(text: str, dtype: DTypeLike, width: int = 1) -> np.ndarray:
    """(count,) or, for a width above one, (count, width) values, decoded from the text of `to_text`."""
    values = np.frombuffer(base64.b64decode(text), dtype)
    return values if width == 1 else values.reshape(-1, width)
