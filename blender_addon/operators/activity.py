# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress of the running operator: panels show it, and no other operator starts meanwhile."""

from __future__ import annotations

from zoomout_core.runtime.progress import Progress

# Why no other operator can start meanwhile, as a text for a button.
AT_WORK = "ZoomOut is running: wait, or press ESC"

# The progress, or None where no operator is running.
running: Progress | None = None
