# SPDX-License-Identifier: GPL-3.0-or-later
"""Functions are verbs or the noun that they return, and limits are called min_ and max_."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("zoomout_core", "blender_addon", "meshlab_filter", "benchmarks", "tools")
# A participle alone, or followed by a preposition; "flipped_faces" is a noun, and `need` and `cut_seams` are verbs.
PARTICIPLE = re.compile(
    r"_?(?!need|seed|speed|feed|embed|proceed)"
    r"([a-z]+ed|bent|bound|built|drawn|found|given|held|kept|laid|left|lost|made|seen|sought|taken|told|worn)"
    r"(_(a|and|as|at|between|both|by|for|from|in|into|of|off|on|onto|open|out|over|through|to|together|with)(_.*)?)?"
)
# Public names that scripts use, and benchmark commands.
ALLOWED_FUNCTIONS = {
    "Surface.joined",
    "SpectralBasis.smoothed",
    "downsampled",
    "registered",
    "reported",
    "translated",
    "tuned",
}
# Functions of samples and demos are named after their shapes: "posed", "mirrored".
ALLOWED_FOLDERS = ("benchmarks/generate", "blender_addon/demo", "zoomout_core/samples/", "meshlab_filter/samples.py")
LIMIT = re.compile(r"_?(least|most|fewest)_", re.IGNORECASE)
LIMIT_ANYWHERE = re.compile(rf"\b{LIMIT.pattern}", re.IGNORECASE)
# Superlatives that are not limits.
ALLOWED_LIMITS = {"most_similar"}


def _is_property(node: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    return any("property" in ast.unparse(decorator) for decorator in node.decorator_list)


def participles(source: str) -> list[str]:
    """Functions and methods named by a participle; properties are exempt, as adjectives."""
    found = []

    def visit(node: ast.AST, owner: str) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
                if PARTICIPLE.fullmatch(child.name) and not _is_property(child):
                    found.append(f"{owner}{child.name}")
                visit(child, "")
            else:
                visit(child, f"{child.name}." if isinstance(child, ast.ClassDef) else owner)

    visit(ast.parse(source), "")
    return [name for name in found if name not in ALLOWED_FUNCTIONS]


def limits(source: str) -> set[str]:
    """Variables, arguments, attributes and functions that begin with `least_`, `most_` or `fewest_`."""
    if not LIMIT_ANYWHERE.search(source):  # walking the tree takes much longer
        return set()
    return {name for name in _names(ast.parse(source)) if LIMIT.match(name) and name not in ALLOWED_LIMITS}


def _names(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Attribute):
            yield node.attr
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name


@pytest.mark.parametrize("package", PACKAGES)
def test_functions_are_verbs_or_nouns_and_limits_are_min_and_max(package: str) -> None:
    for path in sorted((ROOT / package).rglob("*.py")):
        place = path.relative_to(ROOT).as_posix()
        if not place.startswith(ALLOWED_FOLDERS):
            source = path.read_text("utf-8")
            assert (place, participles(source), limits(source)) == (place, [], set())


@pytest.mark.parametrize("name", ["conformed", "held_off", "_bent_to_points", "turned_to_inverse", "_found"])
def test_a_participle_is_found(name: str) -> None:
    assert participles(f"def {name}(): ...") == [name]
    assert participles(f"class Shape:\n    async def {name}(self): ...") == [f"Shape.{name}"]


@pytest.mark.parametrize("name", ["conform", "mirrored_places", "is_closed", "with_flipped_edges", "need", "cut"])
def test_verbs_nouns_and_predicates_may_be_functions(name: str) -> None:
    assert participles(f"def {name}(): ...") == []
    assert participles(f"class Shape:\n    @property\n    def {name}(self): ...") == []


def test_a_property_may_be_an_adjective() -> None:
    assert participles("class Shape:\n    @cached_property\n    def flipped(self): ...") == []


@pytest.mark.parametrize(
    "source", ["LEAST_AREA = 1", "def f(most_points): ...", "shape.fewest_faces", "_MOST_ROWS = 2"]
)
def test_a_limit_under_another_name_is_found(source: str) -> None:
    assert len(limits(source)) == 1
