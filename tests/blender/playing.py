# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that play something, without a window: the `bpy` module has none."""

from types import SimpleNamespace

import bpy

from blender_addon.operators.base.play_operator import PlayOperator


class Window:
    """A replacement of the context of a window: it counts timers, and records the text of the status bar."""

    def __init__(self):
        self.window = self.window_manager = self.workspace = self
        self.status, self.timers, self.handlers, self.modal_operators = None, 0, 0, []

    def __getattr__(self, name):
        return getattr(bpy.context, name)

    def event_timer_add(self, step, window):
        self.timers += 1
        return "timer"

    def event_timer_remove(self, timer):
        self.timers -= 1

    def modal_handler_add(self, operator):
        self.handlers += 1

    def status_text_set(self, text):
        self.status = text


class Playing:
    """An operator with simulated events."""

    def __init__(self):
        self.window, self.reports = Window(), []

    def report(self, level, text):
        self.reports.append(text)

    def event(self, kind, value="PRESS"):
        return self.modal(self.window, SimpleNamespace(type=kind, value=value))


def playing(kind):
    """An operator of a kind, which Blender would make itself."""
    own = {name: value for base in (PlayOperator, kind) for name, value in vars(base).items() if name[:2] != "__"}
    return type("Played", (Playing,), {name: value for name, value in own.items() if not name.startswith("bl_")})()
