# SPDX-License-Identifier: GPL-3.0-or-later
"""The filters on files: `python -m meshlab_filter transfer SOURCE TARGETS... -o OUT`, and scripts of them."""

from zoomout_core.__main__ import run

if __name__ == "__main__":
    run("meshlab_filter.commands", "python -m meshlab_filter", "meshlab")
