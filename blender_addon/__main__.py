# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m blender_addon COMMAND …`: the command line in a Python that has Blender as a module."""

import os
import sys

from . import cli, registered

if __name__ == "__main__":
    with registered():
        status = cli.main(sys.argv[1:])
    # Once classes were registered, Blender's module crashes at exit in 4.2 and hangs in 4.5.
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)
