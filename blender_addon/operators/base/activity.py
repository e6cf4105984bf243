# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress of the running operator: panels show it, and other operators wait for its end."""

from __future__ import annotations

from zoomout_core.runtime.progress import Progress

# Reason for a greyed-out button while an operator is running.
AT_WORK = "ZoomOut is running: wait, or press ESC"

# The progress, or None if no operator is running.
running: Progress | None = None
