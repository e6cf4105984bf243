# SPDX-License-Identifier: GPL-3.0-or-later
"""Random damage of files for `fuzz.py`: of any bytes, of binary data in GLB files, and of the structure of JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from copy import deepcopy
from typing import Any

import numpy as np

NUMBER = re.compile(rb"-?\d+(?:\.\d+)?")
# Replacements of numbers.
NUMBERS = (b"0", b"-1", b"1e308", b"nan", b"inf", b"4294967295", b"2147483648", b"99999999999", b"1.5", b"x", b"")
# Replacements of values in JSON.
VALUES: tuple[Any, ...] = (
    *(None, True, False, -1, 0, 1, 2, 3, 7, 255, 5120, 5126, 1 << 16, 1 << 31, 1 << 53, 10**400, 0.5, -0.5, 1e308),
    *(
        float("nan"),
        float("inf"),
        "",
        "a",
        "0",
        "VEC3",
        "SCALAR",
        "MAT4",
        "../a",
        "missing.bin",
        "data:,",
        "data:;base64,A",
    ),
    *([], {}, [[]], [0], [0, 0], [0, 1, 2, 3], [-1], ["a"], [None], {"a": 0}, {"POSITION": 0}, {"index": 0}),
)
BYTES = (b"\x00", b"\xff", b"\n", b"\r\n", b" ", b"\xef\xbb\xbf", b"#", b"\xff\xff\xff\xff", b"\x00\x00\x00\x80")


def damage(content: bytes, random: np.random.Generator) -> bytes:
    """Damage a file in one or a few ways."""
    broken = bytearray(content)
    for _ in range(random.geometric(0.6)):
        at = int(random.integers(0, len(broken) + 1))
        match random.choice(7, p=[0.04, 0.1, 0.1, 0.2, 0.1, 0.16, 0.3]):
            case 0:
                del broken[at:]
            case 1:
                del broken[at : at + int(random.integers(1, 64))]
            case 2:
                broken[at:at] = BYTES[random.integers(len(BYTES))]
            case 3 if at < len(broken):
                broken[at] ^= 1 << int(random.integers(8))
            case 4:
                broken[at:at] = broken[at : at + int(random.integers(1, 200))]
            case 5 if at < len(broken):
                broken[at : at + 4] = random.bytes(4)
            case _:
                numbers = list(NUMBER.finditer(bytes(broken)))
                if numbers:
                    start, end = numbers[random.integers(len(numbers))].span()
                    broken[start:end] = NUMBERS[random.integers(len(NUMBERS))]
    return bytes(broken)


def damage_binary(content: bytes, random: np.random.Generator) -> bytes:
    """Damage the binary data of a GLB file in one or a few bytes: its JSON stays, so that its streams are decoded."""
    broken, start = bytearray(content), 20 + int.from_bytes(content[12:16], "little") + 8
    for at in random.integers(start, len(content), random.geometric(0.3)):
        broken[at] = random.integers(256) if random.random() < 0.5 else broken[at] ^ 1 << int(random.integers(8))
    return bytes(broken)


def damage_structure(content: bytes, random: np.random.Generator) -> bytes:
    """Damage the JSON of a file in one or a few places: it stays JSON."""
    tree = json.loads(content)
    for _ in range(random.geometric(0.6)):
        places = list(_places(tree))
        if not places:
            break
        part, key = places[random.integers(len(places))]
        other, other_key = places[random.integers(len(places))]
        match random.choice(6, p=[0.4, 0.2, 0.15, 0.1, 0.05, 0.1]):
            case 0:
                part[key] = deepcopy(VALUES[random.integers(len(VALUES))])
            case 1:
                part[key] = deepcopy(other[other_key])
            case 2:
                del part[key]
            case 3 if isinstance(part, list):
                part.extend(deepcopy(part[key]) for _ in range(int(random.integers(1, 40))))
            case 4:
                part[key] = [part[key]]
            case _ if isinstance(part[key], int):
                part[key] = int(part[key] + random.integers(-3, 4))
    return json.dumps(tree).encode()


def _places(part: Any) -> Iterator[tuple[Any, Any]]:
    """Each object or list within a part, with each key or index in it."""
    for key in part if isinstance(part, dict) else range(len(part)) if isinstance(part, list) else ():
        yield part, key
        yield from _places(part[key])
