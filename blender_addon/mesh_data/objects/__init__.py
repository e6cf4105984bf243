# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that are converted as a whole or made: levels of detail, links, clothes, strands, copies, text."""
