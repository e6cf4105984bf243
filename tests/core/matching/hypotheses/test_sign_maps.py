# SPDX-License-Identifier: GPL-3.0-or-later
"""Sign combinations of the first eigenfunctions; only their number matters."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from zoomout_core.matching.hypotheses.signs import sign_hypotheses


def with_functions(count: int) -> Any:
    return SimpleNamespace(basis=SimpleNamespace(eigenvalues=np.arange(float(count))))


def test_all_sign_combinations_are_tried_and_named() -> None:
    hypotheses = sign_hypotheses(with_functions(9), with_functions(30))
    assert len(hypotheses) == 8 + 16 + 32
    patterns = {tuple(np.diag(hypothesis.functional_map)) for hypothesis in hypotheses}
    assert len(patterns) == len(hypotheses)
    assert all(pattern[0] == 1 and set(np.abs(pattern)) == {1.0} for pattern in patterns)
    for hypothesis in hypotheses:
        signs = ["+" if number > 0 else "-" for number in np.diag(hypothesis.functional_map)[1:]]
        assert hypothesis.origin == "signs of eigenfunctions " + "".join(signs)


def test_maps_are_no_larger_than_either_basis() -> None:
    few, many = with_functions(5), with_functions(30)
    for shapes in ((few, many), (many, few)):
        assert {len(hypothesis.functional_map) for hypothesis in sign_hypotheses(*shapes)} == {4, 5}
