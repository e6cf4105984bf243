# SPDX-License-Identifier: GPL-3.0-or-later
"""The documentation is correct: its links resolve, its code runs, and its commands and names exist."""

from __future__ import annotations

import ast
import importlib
import re
import shlex
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner
from guide import ROOT

import zoomout_core as zo
from zoomout_core.samples import characters

pytestmark = pytest.mark.usefixtures("remember_matches")

DOCS = ROOT / "docs"
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.rglob("*.md")])
# `make docs` runs the other pages that have code, too.
TUTORIALS = sorted(DOCS.glob("tutorial_*.md"))
CELL = re.compile(r"(?ms)^```\{code-cell\} ipython3\n(.*?)^```$")
NAMES = [page.relative_to(ROOT).as_posix() for page in PAGES]


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def without_code(text: str) -> str:
    return re.sub(r"(?ms)^(```|:::).*?^\1$|`[^`\n]*`", "", text)


def anchors(page: Path) -> set[str]:
    """The anchors that a link to a page may name after #."""
    headings = re.findall(r"(?m)^#+ (.*)$", re.sub(r"(?ms)^```.*?^```$", "", text_of(page)))
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def code_of(page: Path) -> Iterator[str]:
    """The Python blocks of a page, without shell lines."""
    for block in re.findall(r"(?ms)^```(?:python|\{code-cell\} ipython3)\n(.*?)^```$", text_of(page)):
        yield re.sub(r"(?m)^(!.*|:tags:.*|# .*, (after|new).*)$", "", block)


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_links_and_pictures_resolve(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", without_code(text_of(page))):
        if re.match(r"[a-z]+:", target):
            continue
        place, _, anchor = target.partition("#")
        there = (page.parent / place) if place else page
        assert there.exists(), target
        assert not anchor or anchor in anchors(there), target


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_package_names_in_pages_exist(page: Path) -> None:
    used = set(re.findall(r"\bzo\.([a-z_A-Z]\w*)(?:\.([a-z]\w*))?", text_of(page)))
    for name, inner in used:
        if name == "plotting" and find_spec("matplotlib") is None:
            continue
        assert hasattr(zo, name), f"zo.{name}"
        if name in ("plotting", "samples") and inner:
            assert hasattr(getattr(zo, name), inner), f"zo.{name}.{inner}"
    for module in set(re.findall(r"`(zoomout_core(?:\.\w+)+)", text_of(page))):
        parent, _, name = module.rpartition(".")
        try:
            importlib.import_module(module)
        except ModuleNotFoundError:
            assert hasattr(importlib.import_module(parent), name), module


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_python_blocks_parse(page: Path) -> None:
    for code in code_of(page):
        if not code.lstrip("\n").startswith(" "):  # an indented block is a row to insert into a table
            ast.parse(code)


@pytest.mark.parametrize("page", PAGES, ids=NAMES)
def test_command_options_in_pages_exist(page: Path) -> None:
    from zoomout_core.cli import main

    for line in re.findall(r"(?m)^(?:    |!|`)zoomout ([^`\n#]*)", text_of(page)):
        name, *words = shlex.split(line.split("2>")[0])
        if name.startswith("-"):
            continue
        command = main.get_command(click.Context(main), name)
        known = {option for each in command.params if isinstance(each, click.Option) for option in each.opts}
        assert {word for word in words if word.startswith("-")} <= known, line


def test_reference_lists_all_public_names() -> None:
    told = set(re.findall(r"\.\. auto\w+:: (\w+)", text_of(DOCS / "api" / "core.md")))
    assert told == set(zo.__all__)


def test_every_picture_is_in_a_page() -> None:
    pages = "".join(map(text_of, PAGES))
    assert [path.name for path in sorted((DOCS / "images").iterdir()) if path.name not in pages] == []


def test_every_page_is_listed_in_the_index() -> None:
    listed = set(re.findall(r"(?m)^([\w/]+\*?)$", text_of(DOCS / "index.md")))
    pages = {page.relative_to(DOCS).with_suffix("").as_posix() for page in DOCS.rglob("*.md")}
    assert {page for page in pages if page not in listed and f"{page}*" not in listed} == {"index", "extension_page"}


def test_pyfm_table_covers_all_public_methods() -> None:
    pytest.importorskip("pyFM")
    from pyFM.functional import FunctionalMapping
    from pyFM.mesh.trimesh import TriMesh

    told = set(re.findall(r"\w+", text_of(DOCS / "coming_from.md")))
    offered = {name for each in (TriMesh, FunctionalMapping) for name in vars(each) if not name.startswith("_")}
    assert offered <= told


def shell(line: str) -> int:
    """Run a command line of a tutorial in this process and return its exit code."""
    from zoomout_core.cli import main

    command, *words = shlex.split(line.removesuffix("2> /dev/null"))
    assert command == "zoomout", line
    outcome = CliRunner().invoke(main, words, catch_exceptions=False)
    print(outcome.output)
    return outcome.exit_code


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS, ids=[page.stem for page in TUTORIALS])
def test_tutorials_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.chdir(tmp_path)
    # Use coarse meshes: `make docs` runs the pages at full resolution.
    monkeypatch.setattr(characters, "FINE", 3000)
    monkeypatch.setattr(characters, "VOXELS", 32)
    code = "\n".join(re.sub(r"(?m)^:tags:.*$", "", cell) for cell in CELL.findall(text_of(page)))
    code = re.sub(r"(?m)^!(.*)$", lambda line: f"_exit_code = _shell({line[1]!r})", code)
    exec(compile(code, page.name, "exec"), {"display": print, "_shell": shell})


def test_the_readme_is_short_and_its_python_runs() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.split()) < 800
    (code,) = [each for each in code_of(ROOT / "README.md") if "zo.match" in each]
    made: dict[str, Any] = {}
    exec(code, made)
    assert made["result"].verdict.level == "green"
