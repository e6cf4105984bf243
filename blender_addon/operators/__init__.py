"""Operators: thin, the work is in functions that scripts can call as well."""

from . import symmetry
from .cut_seams import ZOOMOUT_OT_cut_seams
from .match import ZOOMOUT_OT_match
from .transfer import ZOOMOUT_OT_transfer

# In the order in which Blender is to know them.
CLASSES = (ZOOMOUT_OT_match, ZOOMOUT_OT_transfer, ZOOMOUT_OT_cut_seams, *symmetry.CLASSES)
