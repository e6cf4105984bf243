# SPDX-License-Identifier: GPL-3.0-or-later
"""Replacements of Blender's layout and context, to draw panels and menus without a window."""

from types import SimpleNamespace

import bpy

# Names of panels within panels that the user has opened.
OPENED = set[str]()
ICONS = bpy.types.UILayout.bl_rna.functions["label"].parameters["icon"].enum_items


class Layout:
    """A replacement of Blender's layout: it records what is drawn, and refuses what Blender would refuse."""

    def __init__(self, drawn, above=None):
        object.__setattr__(self, "drawn", drawn)
        object.__setattr__(self, "above", above)
        object.__setattr__(self, "enabled", True)
        object.__setattr__(self, "operators", above.operators if above else [])

    def __setattr__(self, name, value):
        assert name in bpy.types.UILayout.bl_rna.properties, name
        object.__setattr__(self, name, value)

    def usable(self):
        return self.enabled and (self.above is None or self.above.usable())

    def _inner(self, **_):
        return Layout(self.drawn, self)

    row = column = box = split = grid_flow = _inner

    def prop(self, settings, name, **_):
        assert name in settings.bl_rna.properties, name
        self.drawn.append(("prop", name, self.usable))

    def prop_search(self, settings, name, searched, collection):
        assert hasattr(searched, collection)
        self.prop(settings, name)

    def label(self, text="", icon="NONE", translate=True):
        assert icon in ICONS
        self.drawn.append(("label", text, self.usable))
        self.drawn.append(("mark", icon, self.usable))

    def operator(self, name, text=None, icon="NONE", translate=True, depress=False):
        assert icon in ICONS
        owner, kind = name.split(".")
        kind = getattr(getattr(bpy.ops, owner), kind).get_rna_type()
        self.drawn.append(("operator", kind.name if text is None else text, self.usable))
        self.operators.append(name)
        return SimpleNamespace()

    def menu(self, name):
        assert issubclass(getattr(bpy.types, name), bpy.types.Menu)
        self.drawn.append(("menu", name, self.usable))

    def popover(self, panel, text="", icon="NONE"):
        assert issubclass(getattr(bpy.types, panel), bpy.types.Panel)
        assert icon in ICONS

    def progress(self, text, factor):
        self.drawn.append(("progress", text, lambda: factor))

    def template_list(self, kind, _, owner, name, active_owner, active_name, rows):
        assert hasattr(bpy.types, kind)
        assert name in owner.bl_rna.properties
        assert active_name in active_owner.bl_rna.properties
        self.drawn.append(("list", name, lambda: rows))

    def panel(self, name, default_closed=False):
        assert self.above is None  # Blender allows panels only in the layout of a panel
        return Layout(self.drawn, self), None if default_closed and name not in OPENED else Layout(self.drawn, self)

    def separator(self):
        pass

    def template_icon(self, icon_value, scale):
        self.drawn.append(("icon", icon_value, lambda: scale))


class Context:
    """Blender's context with a region of some width."""

    region = SimpleNamespace(width=300)
    preferences = SimpleNamespace(
        system=SimpleNamespace(ui_scale=1.0), ui_styles=[SimpleNamespace(widget=SimpleNamespace(points=11))]
    )

    def __getattr__(self, name):
        return getattr(bpy.context, name)
