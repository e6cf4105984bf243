# SPDX-License-Identifier: GPL-3.0-or-later
"""The kinds of characters in generated sets, one module each."""

from .biped import BIPED
from .bird import BIRD
from .dragon import DRAGON
from .hand import HAND
from .kind import Build, Kind, Reach
from .quadruped import QUADRUPED

KINDS: dict[str, Kind] = {"biped": BIPED, "bird": BIRD, "dragon": DRAGON, "hand": HAND, "quadruped": QUADRUPED}

__all__ = ["KINDS", "Build", "Kind", "Reach"]
