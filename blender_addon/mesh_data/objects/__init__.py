# SPDX-License-Identifier: GPL-3.0-or-later
"""Conversion of whole objects, and creation of new ones: levels of detail, links, clothes, strands, copies, text."""
