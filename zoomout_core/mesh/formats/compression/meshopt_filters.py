# SPDX-License-Identifier: GPL-3.0-or-later
"""The filters of glTF files that are compressed by meshopt, see EXT_meshopt_compression and KHR_meshopt_compression.

A filter is applied to elements after their stream is decoded, or before it is encoded.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from zoomout_core.arrays import Floats
from zoomout_core.mesh.formats.compression.meshopt_attributes import Bytes

# The bytes of an element that each filter may have; None for any that the streams have.
STRIDES: dict[str, tuple[int, ...] | None] = {
    "NONE": None,
    "OCTAHEDRAL": (4, 8),
    "QUATERNION": (8,),
    "EXPONENTIAL": None,
    "COLOR": (4, 8),
}
# The smallest exponent that the specification allows.
MIN_EXPONENT = -100


def decode_filter(elements: Bytes, name: str) -> Bytes:
    """Decode elements (n, stride) by a filter with one of the strides of `STRIDES`."""
    if name == "NONE":
        return elements
    if name == "EXPONENTIAL":
        values = np.ascontiguousarray(elements).view("<i4")
        decoded = np.ldexp((values << 8 >> 8).astype(np.float32), values >> 24)
    elif name == "QUATERNION":
        decoded = _decode_quaternions(np.ascontiguousarray(elements).view("<i2"))
    else:
        width = elements.shape[1] // 4
        kind = f"<{'u' if name == 'COLOR' else 'i'}{width}"
        values = np.ascontiguousarray(elements).view(kind)
        decoded = (_decode_colors if name == "COLOR" else _decode_octahedral)(values)
    return np.ascontiguousarray(decoded).view(np.uint8)


def _decode_octahedral(values: NDArray[Any]) -> NDArray[Any]:
    """Unit vectors, and a fourth number that stays, from (n, 4) octahedral coordinates."""
    most = np.iinfo(values.dtype).max
    one = np.maximum(values[:, 2:3].astype(np.float64), 1)
    x, y = (values[:, :2] / one).T
    z = 1 - np.abs(x) - np.abs(y)
    fold = np.minimum(z, 0)
    vector = np.column_stack([x + np.where(x < 0, -fold, fold), y + np.where(y < 0, -fold, fold), z])
    vector /= np.maximum(np.linalg.norm(vector, axis=1, keepdims=True), 1e-12)
    return np.column_stack([np.rint(vector * most).astype(values.dtype), values[:, 3]])


def _decode_quaternions(values: NDArray[np.int16]) -> NDArray[np.int16]:
    """(n, 4) quaternions from three components, and the place of the largest one."""
    three = values[:, :3] / ((values[:, 3:] | 3) * np.sqrt(2.0))
    largest = np.sqrt(np.maximum(1 - (three**2).sum(axis=1, keepdims=True), 0))
    whole = np.clip(np.rint(np.hstack([largest, three]) * 32767), -32767, 32767).astype(np.int16)
    decoded = np.empty_like(whole)
    np.put_along_axis(decoded, ((values[:, 3:] & 3) + np.arange(4)) % 4, whole, axis=1)
    return decoded


def _decode_colors(values: NDArray[Any]) -> NDArray[Any]:
    """(n, 4) colours from brightness, differences of orange and green, and alpha with the number of bits."""
    bits = values.dtype.itemsize * 8
    most, alpha = (1 << bits) - 1, values[:, 3].astype(np.int64)
    scale = alpha.copy()
    for shift in (1, 2, 4, 8):
        scale |= scale >> shift
    brightness = values[:, 0].astype(np.int64)
    orange, green = np.ascontiguousarray(values[:, 1:3]).view(f"<i{bits // 8}").astype(np.int64).T
    color = [
        brightness + orange - green,
        brightness + green,
        brightness - orange - green,
        alpha << 1 & scale | alpha & 1,
    ]
    whole = np.rint(np.column_stack(color) * (most / np.maximum(scale, 1))[:, None])
    return np.clip(whole, 0, most).astype(values.dtype)


def encode_octahedral(vectors: Floats, bits: int) -> Bytes:
    """Encode unit vectors (n, 3) in elements of 8 bytes, with a number of bits for each coordinate."""
    most = (1 << (bits - 1)) - 1
    flat = vectors / np.maximum(np.abs(vectors).sum(axis=1, keepdims=True), 1e-12)
    x, y, z = flat.T
    folded = [np.where(z < 0, (1 - np.abs(other)) * np.where(one < 0, -1, 1), one) for one, other in ((x, y), (y, x))]
    rows = np.column_stack([*folded, np.ones(len(flat)), np.zeros(len(flat))])
    return np.rint(rows * most).astype("<i2").view(np.uint8)


def encode_exponential(values: Floats, step: float) -> Bytes:
    """Encode numbers (n, w) as multiples of a power of two that is at most `step`, or more if they are large.

    Multiples have 24 bits, so the step grows to a 2^23rd of the largest number.
    """
    largest = float(np.abs(values).max(initial=0))
    smallest = max(np.floor(np.log2(step)), MIN_EXPONENT)
    exponent = int(max(smallest, np.ceil(np.log2(max(largest, 1e-30) / (2**23 - 1)))))
    mantissa = np.rint(np.ldexp(values.astype(np.float64), -exponent)).astype(np.int64)
    return (mantissa & 0xFFFFFF | (exponent & 0xFF) << 24).astype("<u4").view(np.uint8)
