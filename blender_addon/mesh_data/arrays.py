"""Whole arrays of properties of a mesh's elements."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike


def read_array(elements: Any, name: str, dtype: DTypeLike, width: int = 1) -> np.ndarray:
    """(count,) or, for a width above one, (count, width) values of a property of all elements."""
    values = np.empty(len(elements) * width, dtype)
    elements.foreach_get(name, values)
    return values if width == 1 else values.reshape(-1, width)
