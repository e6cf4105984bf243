# SPDX-License-Identifier: GPL-3.0-or-later
"""Data of vertices, edges, faces and corners: layers, marks, normals, materials, vertex groups, selections."""
