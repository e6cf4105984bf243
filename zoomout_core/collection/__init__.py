# SPDX-License-Identifier: GPL-3.0-or-later
"""Many shapes at once: prepare each once, match them in pairs, and choose maps that agree."""
