# SPDX-License-Identifier: GPL-3.0-or-later
"""Many shapes at once: prepared once each, matched in pairs, and their maps brought to agree."""
