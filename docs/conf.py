# SPDX-License-Identifier: GPL-3.0-or-later
"""How Sphinx makes the documentation; `make docs` calls it."""

import os
import sys
from importlib.util import find_spec
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
# The code of tutorials is timed on what it computes, not on what an earlier build has kept.
os.environ["ZOOMOUT_CACHE"] = "off"

from sphinx.util.inspect import TypeAliasForwardRef

from zoomout_core import __version__

project = "ZoomOut Transfer"
author = "The ZoomOut Transfer developers"
version = release = str(__version__)

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_click",
    "sphinx_copybutton",
]
# The page on Blender's site is entered there; that of the paper is written by the benchmarks.
exclude_patterns = ["extension_page.md"]
# The reference of Blender's functions needs Blender as a module, which `make docs` alone does not install.
if find_spec("bpy") is None:
    exclude_patterns.append("api/blender.md")
    suppress_warnings = ["toc.excluded", "toc.not_readable"]

myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_type_aliases = {
    "ArrayLike": "ArrayLike",
    "ShapeLike": "ShapeLike",
    "Landmarks": "Landmarks",
    "Regions": "Regions",
    "Floats": "Floats",
    "Integers": "Integers",
    "Booleans": "Booleans",
}
# Signatures show the names of these aliases; Sphinx 9 shows its placeholder for them in unions.
TypeAliasForwardRef.__repr__ = lambda alias: alias.name
autodoc_default_options = {"members": True}
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_attr_annotations = False
python_display_short_literal_types = True
maximum_signature_line_length = 90

# What docstrings have between backticks is code, and a link where it is a public name.
default_role = "py:obj"

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["tables.css"]
html_title = f"ZoomOut Transfer {release}"
html_show_copyright = False
html_copy_source = False
copybutton_exclude = ".linenos, .gp, .go"
