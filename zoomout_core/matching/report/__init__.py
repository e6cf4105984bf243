# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of a match: verdict, parts of the source, and notes."""

from typing import TYPE_CHECKING

from zoomout_core.runtime.first_use import modules_on_first_use

if TYPE_CHECKING:
    from zoomout_core.matching.report import notes as notes
    from zoomout_core.matching.report import part_report as part_report
else:
    __getattr__ = modules_on_first_use(__name__)
