"""The operator that works in a window: panels show how far it is, and no other begins meanwhile."""

from __future__ import annotations

from zoomout_core.runtime.stepping import Progress

# Why no other work can begin meanwhile, in words for a button.
AT_WORK = "ZoomOut is at work: wait, or press ESC"

# How far the work is, None where there is none.
running: Progress | None = None
