# SPDX-License-Identifier: GPL-3.0-or-later
"""Summaries of large objects: a few lines in a console, a table in a notebook."""

from __future__ import annotations

from abc import abstractmethod
from html import escape


class Summary:
    """Base of classes whose arrays would fill the screen; its dataclasses are declared with `repr=False`."""

    @abstractmethod
    def _summary(self) -> dict[str, str]:
        """The main properties of the object, by short names."""

    def __repr__(self) -> str:
        rows = self._summary()
        width = max(map(len, rows), default=0)
        lines = [f"  {name:{width}}  {text}" for name, text in rows.items()]
        return "\n".join([f"<{type(self).__name__}", *lines]) + ">"

    def _repr_html_(self) -> str:
        rows = "".join(
            f'<tr><th style="text-align:left">{escape(name)}</th><td style="text-align:left">{escape(text)}</td></tr>'
            for name, text in self._summary().items()
        )
        return f"<table><caption>{type(self).__name__}</caption>{rows}</table>"
