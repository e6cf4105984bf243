# SPDX-License-Identifier: GPL-3.0-or-later
"""Choose the pairs of a collection to match."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import cdist

from zoomout_core.arrays import Floats
from zoomout_core.collection.pair_map import PairName
from zoomout_core.mesh.errors import MeshError
from zoomout_core.mesh.formats.opening import existing, file_bytes, shown

# Eigenvalues used to compare shapes: the first, of the constant function, is always zero.
COMPARED = slice(1, 40)
# If a map from the template is less certain (a probability), its shape is also matched with other shapes.
MIN_TEMPLATE_CERTAINTY = 0.9
# Number of these other shapes: those most similar in spectrum among the certain ones. Each costs a match.
SHAPES_BETWEEN = 3
# Distance between two equal shapes: positive, so that a spanning tree sees their edge.
SMALLEST = 1e-12


def pairs_with_template(template: str, names: Sequence[str]) -> list[PairName]:
    """The template as the source of every other shape."""
    return [PairName(template, name) for name in names if name != template]


def all_pairs(names: Sequence[str]) -> list[PairName]:
    """Every pair once, the first of the two as the source."""
    return [PairName(*pair) for pair in combinations(names, 2)]


def pairs_of_neighbours(eigenvalues: Mapping[str, Floats], neighbours: int) -> list[PairName]:
    """Each shape with the most similar ones by eigenvalues (k,), and further pairs that connect all shapes.

    Each chooses `neighbours` others; others may choose it as well.
    """
    names = list(eigenvalues)
    if len(names) < 2:
        return []
    distances = unlikeness([eigenvalues[name] for name in names])
    np.fill_diagonal(distances, np.inf)
    nearest = np.argsort(distances, axis=1, kind="stable")[:, : min(neighbours, len(names) - 1)]
    chosen = {(min(i, int(j)), max(i, int(j))) for i in range(len(names)) for j in nearest[i]}
    np.fill_diagonal(distances, 0.0)
    # A minimum spanning tree connects all shapes; most of its edges join nearest neighbours anyway.
    tree = minimum_spanning_tree(csr_array(np.maximum(distances, SMALLEST))).tocoo()
    chosen |= {(min(i, j), max(i, j)) for i, j in zip(tree.row.tolist(), tree.col.tolist(), strict=True)}
    return [PairName(names[i], names[j]) for i, j in sorted(chosen)]


def pairs_of_uncertain(certainty: Mapping[str, float], eigenvalues: Callable[[str], Floats]) -> list[PairName]:
    """Pairs of each shape whose map from a template is uncertain, as the target, with the most similar certain ones.

    Args:
        certainty: of the maps from the template, by the names of their targets.
        eigenvalues: returns those (k,) of the shape with a name.
    """
    uncertain = [name for name in certainty if certainty[name] < MIN_TEMPLATE_CERTAINTY]
    certain = [name for name in certainty if certainty[name] >= MIN_TEMPLATE_CERTAINTY]
    if not uncertain or not certain:
        return []
    distances = unlikeness([eigenvalues(name) for name in (*uncertain, *certain)])[: len(uncertain), len(uncertain) :]
    nearest = np.argsort(distances, axis=1, kind="stable")[:, :SHAPES_BETWEEN]
    return [PairName(certain[j], name) for name, row in zip(uncertain, nearest.tolist(), strict=True) for j in row]


def unlikeness(eigenvalues: Sequence[Floats]) -> Floats:
    """(c, c) mean difference of the logarithms of the shapes' eigenvalues, which grow linearly by Weyl's law."""
    count = min(min(len(each) for each in eigenvalues), COMPARED.stop)
    logarithms = np.log(np.maximum([each[COMPARED.start : count] for each in eigenvalues], SMALLEST))
    return np.asarray(cdist(logarithms, logarithms, "cityblock") / max(count - COMPARED.start, 1))


def read_pairs(path: str | Path, names: Sequence[str]) -> list[PairName]:
    """The pairs in a file: a source and a target per line, by name or file name.

    Raises:
        MeshError: the file cannot be read, a line does not have two names, or a name is unknown.
    """
    content = file_bytes(existing(path))
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise MeshError(f"{path} is not a list of pairs: save it as plain text in UTF-8.") from error
    known = {name: name for name in names} | {Path(name).stem: name for name in names}
    pairs = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        if len(words) != 2:
            raise MeshError(f"{path}, line {number}: give two names, a source and a target, instead of {len(words)}.")
        for word in words:
            if word not in known and Path(word).stem not in known:
                raise MeshError(
                    f"{path}, line {number}: the collection has no shape named {shown(word)}: correct the name."
                )
        source, target = (known.get(word) or known[Path(word).stem] for word in words)
        if source == target:
            raise MeshError(f"{path}, line {number}: {source} is paired with itself: remove the line.")
        pairs.append(PairName(source, target))
    if not pairs:
        raise MeshError(f"{path} contains no pairs: write a source and a target on each line.")
    return list(dict.fromkeys(pairs))
