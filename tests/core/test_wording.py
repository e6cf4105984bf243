# SPDX-License-Identifier: GPL-3.0-or-later
"""Texts, docstrings, comments and names of tests are plain English, without the habits of a translation."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("zoomout_core", "blender_addon", "meshlab_filter")
HABITS = tuple(
    re.compile(pattern, re.MULTILINE)
    for pattern in (
        r"\b(is|are|was|were) (said|told)\b",
        r"\bkeeps? (its|their) word\b",
        r"\bas good as none\b",
        r"\bso many\b",
        r"\bsurer\b",
        r"(^|\. )Of ",
        r"(^|[.:;] )[Ww]hat (is|are|was|has|have|had|stands?|lies?|can|cannot|comes?|goes|belongs|hangs)\b",
        r"\b(of|as|from|for|in|on|to|and|not) what (is|are|was|has|had|stands|lies|follows|hangs)\b",
        r"\b(is|are|was|were|parts) laid on\b",
        r"\b(its|their) like\b",
        r"\banew\b",
        r"\bonce more\b",
        r"\bthere is none\b",
        r"\bstands? (there|alike|in the way)\b",
        r"\bfor it is\b|\bas (it|they) stands?\b",
        r"\b[Cc]ounterpart",  # the word is "partner"
        r"\bfrom which on\b",
        r"(?<![Tt]here )\b(is|are|be) no (avatar|image|list|map|mesh|number|such)\b",
        r", as (on|between) ",
    )
)
# Those of docstrings and comments, which may have the others.
CODE_HABITS = tuple(
    re.compile(pattern)
    for pattern in (
        r"^\W*What (?!.*\?)",
        r"(\. |: )What (is|are|was|were|has|can|cannot)\b",
        r"\banew\b",
        r"\bonce more\b",
        r"\bso many\b(?! (that|as))",
        r"\bsurer\b",
        r"\b(is|are|was|were) (said|told)\b",
        r"\bkeeps? (its|their) word\b",
        r"\bas good as none\b",
        r"\b[Cc]ounterpart",
        r"\bfrom which on\b",  # "above which"
        r"(?<![Tt]here )\b(is|are|be) no (avatar|image|list|map|mesh|number|such)\b",  # "is not a"
        r", as (on|between) ",  # "such as"
    )
)
HASH = re.compile("#.*")
TEST_NAME = re.compile(r"^ *(?:async )?def test_(\w+)", re.MULTILINE)


def _docstrings(tree: ast.Module) -> set[ast.AST]:
    owners = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    bodies = (node.body for node in ast.walk(tree) if isinstance(node, owners))
    return {body[0].value for body in bodies if body and isinstance(body[0], ast.Expr)}


def _comments(source: str) -> Iterator[tuple[int, str]]:
    """Lines and texts of docstrings, with line breaks as spaces, and of comments if some in the file may be stiff."""
    for node in _docstrings(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, " ".join(node.value.split())
    if any("What" in line or any(habit.search(line) for habit in CODE_HABITS) for line in HASH.findall(source)):
        for token in tokenize.generate_tokens(io.StringIO(source).readline):  # takes longest
            if token.type == tokenize.COMMENT:
                yield token.start[0], token.string


def _texts(source: str) -> Iterator[tuple[int, str]]:
    """Lines and texts of string literals with several words, except docstrings; `{}` replaces formatted values."""
    tree = ast.parse(source)
    seen = _docstrings(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            seen.update(node.values)
            text = "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in seen:
            text = node.value
        else:
            continue
        if " " in text.strip():
            yield node.lineno, text


def _stiff(source: str) -> list[tuple[int, str]]:
    return [(line, text) for line, text in _texts(source) if any(habit.search(text) for habit in HABITS)]


def _stiff_names(source: str) -> list[str]:
    """Names of tests that have a habit when read as sentences."""
    sentences = {name: name.replace("_", " ").capitalize() for name in TEST_NAME.findall(source)}
    return [
        f"test_{name}"
        for name, sentence in sentences.items()
        if any(habit.search(sentence) for habit in (*HABITS, *CODE_HABITS))
    ]


@pytest.mark.parametrize("package", PACKAGES)
def test_texts_for_users_have_no_habits_of_a_translation(package: str) -> None:
    paths = sorted((ROOT / package).rglob("*.py"))
    found = {
        f"{path.relative_to(ROOT)}:{line}": text for path in paths for line, text in _stiff(path.read_text("utf-8"))
    }
    assert found == {}


@pytest.mark.parametrize("package", [*PACKAGES, "benchmarks", "tools", "tests"])
def test_docstrings_and_comments_have_no_habits_of_a_translation(package: str) -> None:
    found = {
        f"{path.relative_to(ROOT)}:{line}": text
        for path in sorted((ROOT / package).rglob("*.py"))
        for line, text in _comments(path.read_text("utf-8"))
        if any(habit.search(text) for habit in CODE_HABITS)
    }
    assert found == {}


def test_names_of_tests_have_no_habits_of_a_translation() -> None:
    paths = sorted(ROOT.glob("tests/**/*.py"))
    assert paths
    found = {str(path.relative_to(ROOT)): names for path in paths if (names := _stiff_names(path.read_text("utf-8")))}
    assert found == {}


@pytest.mark.parametrize(
    "code",
    [
        '"""What is drawn."""',
        "x = 1  # computed anew",
        '"""A line. What is lost."""',
        "LIMIT = 2  # size from which on it is large",
        '"""None if it is no image."""',
        '"""Rounding errors, as on a sphere, are zero."""',
    ],
)
def test_a_stiff_comment_is_found(code: str) -> None:
    assert [text for _, text in _comments(code) if any(habit.search(text) for habit in CODE_HABITS)]


@pytest.mark.parametrize("code", ['"""There is no mesh."""', "x = 1  # above which it is not a map"])
def test_a_plain_comment_is_accepted(code: str) -> None:
    assert not [text for _, text in _comments(code) if any(habit.search(text) for habit in CODE_HABITS)]


@pytest.mark.parametrize(
    "text",
    [
        '"What stands in the way is said above."',
        'f"{count} parts are laid on their like."',
        'ValueError("Of these give one.")',
        '"Start. Of a file the lines are read."',
        '"The shape is prepared anew."',
        '"Its maps are surer."',
        '"It is no image of a known type."',
        '"The share from which on a map is red."',
        '"The lips are joined, as on many scans."',
        '("Name of the collection " "of what is carried")',
    ],
)
def test_a_stiff_text_is_found(text: str) -> None:
    source = "\n".join(('"""What is said in a docstring."""', f"note = {text}"))
    assert _stiff(source) == list(_texts(source)) != []


@pytest.mark.parametrize(
    "name",
    [
        "test_what_no_face_uses_stays",
        "test_of_two_maps_the_nearer_one_is_taken",
        "test_no_scheduler_is_said",
        "test_each_shell_finds_its_like",
        "test_a_file_is_read_once_more",
        "test_its_maps_are_surer",
    ],
)
def test_a_stiff_name_is_found(name: str) -> None:
    assert _stiff_names(f"def {name}() -> None: ...") == [name]
    assert _stiff_names(f"class TestShapes:\n    async def {name}(self) -> None: ...") == [name]


@pytest.mark.parametrize(
    "name", ["test_missing_scheduler_is_reported", "test_fit_is_that_of_the_whole", "what_is_left"]
)
def test_plain_names_and_other_functions_are_accepted(name: str) -> None:
    assert _stiff_names(f"def {name}() -> None: ...") == []
