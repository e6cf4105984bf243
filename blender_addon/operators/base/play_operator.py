# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that play something in the viewport until a click or ESC, and then restore the scene."""

from __future__ import annotations

from time import monotonic

from bpy.types import Context, Event, Operator, Timer

from ...translations import reported, translated
from . import running_operators
from .availability import is_available

# Seconds between two steps.
STEP = 0.04
# Events that end the operator, and those that only turn the view.
ENDING = ("ESC", "RET", "LEFTMOUSE", "RIGHTMOUSE")
OF_VIEW = ("MIDDLEMOUSE", "MOUSEMOVE", "WHEELUPMOUSE", "WHEELDOWNMOUSE", "TRACKPADPAN", "TRACKPADZOOM", "NDOF_MOTION")
# Events that go to the previous or the next part.
STEPS = {"LEFT_ARROW": -1, "RIGHT_ARROW": 1}


class PlayOperator(Operator):
    """The base of operators that play; subclasses define the parts to show.

    Attributes:
        seconds: of each part.
    """

    seconds = 1.0

    @classmethod
    def obstacle(cls, context: Context) -> str:
        """The reason why nothing can be played; empty if it can."""
        raise NotImplementedError

    def start(self, context: Context) -> int:
        """Store the state to restore; returns the number of parts.

        Raises:
            MeshError: nothing can be played.
        """
        raise NotImplementedError

    def show(self, context: Context, part: int, share: float) -> str:
        """Show a part at a share of its time; returns the text for the status bar."""
        raise NotImplementedError

    def restore(self, context: Context) -> None:
        """Restore the previous state; a script may have removed objects meanwhile."""
        raise NotImplementedError

    @classmethod
    def poll(cls, context: Context) -> bool:
        """Whether something can be played."""
        return is_available(cls, cls.obstacle(context))

    def invoke(self, context: Context, event: Event) -> set[str]:
        """Start to play."""
        if not running_operators.can_begin(context.window):
            self.report({"ERROR"}, reported("A 3D viewport is needed: move the mouse over one, and try again"))
            return {"CANCELLED"}
        self._parts = self.start(context)
        self._begun = monotonic()
        self._timer: Timer = context.window_manager.event_timer_add(STEP, window=context.window)
        running_operators.begin(context, self)
        self._play(context)
        return {"RUNNING_MODAL"}

    def modal(self, context: Context, event: Event) -> set[str]:
        """Play, or end. Only events of the view pass through, so that nothing else happens meanwhile."""
        if event.type in ENDING and event.value == "PRESS":
            self.cancel(context)
            return {"CANCELLED"}
        if event.type in STEPS and event.value == "PRESS":
            part = (monotonic() - self._begun) // self.seconds + STEPS[event.type]
            self._begun = monotonic() - part % self._parts * self.seconds
            self._play(context)
        if event.type == "TIMER":
            self._play(context)
        return {"PASS_THROUGH"} if event.type in (*OF_VIEW, "TIMER") else {"RUNNING_MODAL"}

    def cancel(self, context: Context) -> None:
        """Restore the scene; Blender calls this when a file is loaded or the window closes."""
        running_operators.end(self)
        self.restore(context)
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)

    def _play(self, context: Context) -> None:
        """Show what belongs to the current time."""
        time = (monotonic() - self._begun) / self.seconds
        context.workspace.status_text_set(translated(self.show(context, int(time) % self._parts, time % 1)))
