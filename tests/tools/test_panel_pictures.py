# SPDX-License-Identifier: GPL-3.0-or-later
"""The guide's pictures of panels: all can be taken again after a change of the panels."""

import re

import extension

SCRIPT = extension.ROOT / "tools" / "panel_pictures.py"


def test_every_panel_picture_is_taken_by_the_script():
    taken = re.findall(r'\bpicture\("(\w+)"', SCRIPT.read_text())
    assert sorted(taken) == sorted(path.stem for path in (extension.DOCS / "images").glob("panel_*.png"))
