# SPDX-License-Identifier: GPL-3.0-or-later
"""The pages name benchmarks that exist, and the README of the benchmarks names all of them."""

import re
from pathlib import Path

from benchmarks.__main__ import main

ROOT = Path(__file__).parents[2]
README = ROOT / "benchmarks" / "README.md"
PAGES = [README, *ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]


def test_the_readme_names_every_benchmark():
    named = set(re.findall(r"`([\w-]+)[ `]", README.read_text(encoding="utf-8")))
    assert main.commands.keys() - named == set()


def test_pages_name_benchmarks_that_exist():
    named = {name for page in PAGES for name in re.findall(r"-m benchmarks ([a-z][\w-]*)", page.read_text("utf-8"))}
    assert named - main.commands.keys() == set()
