# SPDX-License-Identifier: GPL-3.0-or-later
"""The attributes of vertices in glTF files that are compressed by meshopt, decoded and encoded.

They follow the specifications of EXT_meshopt_compression (version 0) and of KHR_meshopt_compression (version 1, which
is only decoded). Elements are stored in blocks, and the bytes of a block one place after the other, as differences from
the element before. Sixteen differences make a group, stored with as few bits as most of them need; those with more
follow in full.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from zoomout_core.runtime.input_files import FormatError

Bytes = NDArray[np.uint8]

# The first byte, without the version.
HEADER = 0xA0
# Bits of a group's differences by its code; in version 1 the control of a block chooses among two rows.
BITS = np.array([0, 2, 4, 8])
MORE_BITS = np.array([[0, 1, 2, 4], [1, 2, 4, 8]])
GROUP = 16
# Maximum of bytes and of elements in a block, and minimum of bytes at the end of a stream, by version.
BLOCK_BYTES, BLOCK_ELEMENTS, TAIL = 8192, 256, (32, 24)


def _block_size(stride: int) -> int:
    """The elements of a block."""
    return min(BLOCK_BYTES // stride & -GROUP, BLOCK_ELEMENTS)


def encode_attributes(elements: Bytes) -> bytes:
    """Encode elements (n, stride), whose stride is divisible by 4 and at most 256, as version 0."""
    count, stride = elements.shape
    first = elements[:1]
    before = np.concatenate([first, elements[:-1]])
    difference = (elements - before).astype(np.int8)
    zigzag = ((difference << 1) ^ (difference >> 7)).astype(np.uint8)
    parts = [bytes([HEADER])]
    size = _block_size(stride)
    for start in range(0, count, size):
        block = zigzag[start : start + size].T
        padded = np.zeros((stride, -(-block.shape[1] // GROUP) * GROUP), np.uint8)
        padded[:, : block.shape[1]] = block
        parts.append(_encode_block(padded.reshape(stride, -1, GROUP)))
    tail = first.tobytes() if count else bytes(stride)
    return b"".join([*parts, bytes(max(TAIL[0] - stride, 0)), tail])


def _encode_block(groups: Bytes) -> bytes:
    """The bytes of a block: groups (stride, g, 16) of differences."""
    stride, count, _ = groups.shape
    large = [(groups >= (1 << bits) - 1) for bits in (2, 4)]
    size = np.stack(
        [
            np.where(groups.any(axis=2), 1 << 10, 0),
            4 + large[0].sum(axis=2),
            8 + large[1].sum(axis=2),
            np.full(groups.shape[:2], GROUP),
        ],
        axis=2,
    )
    code = size.argmin(axis=2)
    own = np.take_along_axis(size, code[..., None], axis=2)[..., 0]
    heads = -(-count // 4)
    start = np.cumsum(np.hstack([np.full((stride, 1), heads), own]).ravel()).reshape(stride, -1)
    start = np.hstack([start[:, :1] - heads, start[:, :-1]])  # of the heads, and of each group
    content = np.zeros(int(start[-1, -1] + own[-1, -1]), np.uint8)
    shifted = np.zeros((stride, heads * 4), np.uint8)
    shifted[:, :count] = code
    content[start[:, :1] + np.arange(heads)] = (shifted.reshape(stride, heads, 4) << [0, 2, 4, 6]).sum(axis=2)
    for number, bits in ((1, 2), (2, 4)):
        chosen = code == number
        at, values, more = start[:, 1:][chosen], groups[chosen], large[number - 1][chosen]
        share = 8 // bits
        short = np.where(more, (1 << bits) - 1, values).reshape(len(at), GROUP // share, share)
        content[at[:, None] + np.arange(GROUP // share)] = (short << bits * np.arange(share)[::-1]).sum(axis=2)
        content[(at[:, None] + GROUP // share + np.cumsum(more, axis=1) - 1)[more]] = values[more]
    chosen = code == 3
    content[start[:, 1:][chosen][:, None] + np.arange(GROUP)] = groups[chosen]
    return content.tobytes()


def decode_attributes(content: bytes, count: int, stride: int) -> Bytes:
    """Decode elements (count, stride).

    Raises:
        FormatError: the stream is damaged.
    """
    if not content or content[0] & 0xF0 != HEADER or content[0] & 0x0F > 1:
        raise FormatError("its compressed attributes have another format")
    version = content[0] & 0x0F
    channels = stride // 4 if version else 0
    tail = max(stride + channels, TAIL[version])
    end = len(content) - tail
    if end < 1:
        raise FormatError("its compressed attributes end too early")
    last = np.frombuffer(content, np.uint8)[len(content) - stride - channels :]
    differences = _Differences(content[:end])
    found = np.zeros((stride, -(-count // GROUP) * GROUP), np.uint8)
    size = _block_size(stride)
    for start in range(0, count, size):
        differences.add_block(start, min(size, count - start), stride, version)
    differences.fill(found)
    found = found[:, :count]
    decoded = _sum_differences(found, last[:stride], last[stride:] if version else np.zeros(stride // 4, np.uint8))
    return np.ascontiguousarray(decoded.T)


class _Differences:
    """The groups of a stream of attributes. They are first located, then decoded together by kind."""

    def __init__(self, content: bytes) -> None:
        self.content, self.at = content, 1
        # The number of bytes that are all ones, in each width, before each byte of the stream.
        data = np.frombuffer(content + bytes(2 * GROUP), np.uint8)
        self.data = data
        ones = {
            1: np.bitwise_count(data) if hasattr(np, "bitwise_count") else np.unpackbits(data).reshape(-1, 8).sum(1),
            2: sum((data >> shift & 3) == 3 for shift in (0, 2, 4, 6)),
            4: sum((data >> shift & 15) == 15 for shift in (0, 4)),
        }
        self.next: dict[int, list[int]] = {}
        for bits, each in ones.items():
            total = np.concatenate([[0], np.cumsum(each, dtype=np.int64)])
            place = np.arange(len(content) + 1)
            self.next[bits] = (place + 2 * bits + total[place + 2 * bits] - total[place]).tolist()
        self.groups: dict[int, tuple[list[int], list[int], list[int]]] = {bits: ([], [], []) for bits in (1, 2, 4, 8)}
        self.whole: list[tuple[int, int, int, int]] = []

    def add_block(self, first: int, count: int, stride: int, version: int) -> None:
        """Find the groups of a block of `count` elements that begins at element `first`."""
        at, content, end = self.at, self.content, len(self.content)
        groups = -(-count // GROUP)
        heads = -(-groups // 4)
        controls = content[at : at + stride // 4] if version else b""
        at += len(controls)
        if version and len(controls) < stride // 4:
            raise FormatError("its compressed attributes end too early")
        for place in range(stride):
            control = controls[place >> 2] >> 2 * (place & 3) & 3 if version else 0
            if control == 2:
                continue
            if control == 3:
                self.whole.append((place, first, at, count))
                at += count
                continue
            choices = MORE_BITS[control].tolist() if version else BITS.tolist()
            head = content[at : at + heads]
            at += heads
            if len(head) < heads or at > end:
                raise FormatError("its compressed attributes end too early")
            for group in range(groups):
                bits = choices[head[group >> 2] >> 2 * (group & 3) & 3]
                if not bits:
                    continue
                if at > end:
                    break
                places, rows, starts = self.groups[bits]
                places.append(place)
                rows.append(first + group * GROUP)
                starts.append(at)
                at = at + GROUP if bits == 8 else self.next[bits][at]
            if at > end:
                raise FormatError("its compressed attributes end too early")
        if at > end:
            raise FormatError("its compressed attributes end too early")
        self.at = at

    def fill(self, found: Bytes) -> None:
        """Write the differences (stride, n) of all groups.

        Raises:
            FormatError: bytes of the stream are left.
        """
        if self.at != len(self.content):
            raise FormatError("its compressed attributes have another size")
        values: Bytes
        for bits, (places, rows, starts) in self.groups.items():
            at = np.array(starts, dtype=np.int64)[:, None]
            if bits == 8:
                values = self.data[at + np.arange(GROUP)]
            else:
                packed = self.data[at + np.arange(2 * bits)]
                shifts = bits * np.arange(8 // bits)
                if bits > 1:  # single bits begin with the lowest
                    shifts = shifts[::-1]
                most = (1 << bits) - 1
                values = (packed[:, :, None] >> shifts & most).reshape(len(at), GROUP).astype(np.uint8)
                more = values == most
                rest = at + 2 * bits + np.cumsum(more, axis=1) - 1
                values = np.where(more, self.data[np.where(more, rest, 0)], values)
            found[
                np.array(places, dtype=np.int64)[:, None], np.array(rows, dtype=np.int64)[:, None] + np.arange(GROUP)
            ] = values
        for place, first, at_whole, count in self.whole:
            found[place, first : first + count] = self.data[at_whole : at_whole + count]


def _sum_differences(found: Bytes, first: Bytes, channels: Bytes) -> Bytes:
    """(stride, n) bytes of elements from differences (stride, n); each four bytes have their own encoding."""
    decoded = np.empty_like(found)
    for number, channel in enumerate(channels.tolist()):
        own = slice(4 * number, 4 * number + 4)
        way = channel & 3
        kind = np.dtype(("<u1", "<u2", "<u4")[way]) if way < 3 else None
        if kind is None:
            raise FormatError("its compressed attributes have another format")
        values = np.ascontiguousarray(found[own].T).view(kind)
        start = np.ascontiguousarray(first[own]).view(kind)
        if way == 2:
            turn = channel >> 4
            turned = values if not turn else (values << turn | values >> (32 - turn)).astype(kind)
            summed = np.bitwise_xor.accumulate(np.concatenate([start[None], turned]), axis=0)[1:]
        else:
            plain = (values >> 1) ^ (0 - (values & 1)).astype(kind)
            summed = start + np.cumsum(plain, axis=0, dtype=kind)
        decoded[own] = np.ascontiguousarray(summed.astype(kind)).view(np.uint8).T
    return decoded
