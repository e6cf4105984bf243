# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables and figures, one module each: `python -m benchmarks NAME --data FOLDER`."""
