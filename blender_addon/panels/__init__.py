"""The sidebar of the 3D view."""

from . import symmetry
from .match import ZOOMOUT_PT_match
from .transfer import ZOOMOUT_PT_transfer

# In the order in which Blender is to know them.
CLASSES = (ZOOMOUT_PT_match, ZOOMOUT_PT_transfer, *symmetry.CLASSES)
