# SPDX-License-Identifier: GPL-3.0-or-later
"""Mutation testing: change the code one line at a time, and list the changes that no test detects.

    make mutants ARGS="zoomout_core/matching --sample 8 --seed 1"
    make mutants ARGS="zoomout_core/matching/ranking/scores.py:48"

Cosmic Ray makes the mutants: small numbers plus or minus one, numbers set to zero; arithmetic, comparisons, logic and
conditions inverted; loops skipped. A package has thousands, so some of each module are drawn at random, the
same ones for the same seed. Each is tested only with the tests nearest to the module: those that import it, or are
named after it, or else are in the corresponding folder. Tests that take longer than `--slowest` seconds are left
out. For a module with a line number all mutants of that line are tested.

Everything runs in a copy of the tree, so that the tree can be edited meanwhile. Durations of tests are stored in
`build/mutants.json`.
"""

import argparse
import ast
import hashlib
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from difflib import unified_diff
from itertools import islice
from pathlib import Path
from queue import Queue

import parso.python.tree
import parso.tree
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.number_replacer import NumberReplacer
from cosmic_ray.operators.operator import Example, Operator
from cosmic_ray.plugins import get_operator

ROOT = Path(__file__).resolve().parent.parent
DURATIONS = ROOT / "build" / "mutants.json"
# Left out of a copy of the tree.
NOT_COPIED = (".*", "__pycache__", "build", "dist", "demo", "*.egg-info")
# Time limit of a mutant's tests: seconds to start, and a multiple of their time without it.
START, TIMES_AS_LONG = 15, 3
LARGEST_SMALL_NUMBER = 12
# Operators whose mutants can run: bitwise operators on floats cannot.
OPERATORS = (
    "AddNot",
    "ZeroIterationForLoop",
    "ReplaceAndWithOr",
    "ReplaceOrWithAnd",
    "ReplaceBreakWithContinue",
    "ReplaceContinueWithBreak",
    "ReplaceTrueWithFalse",
    "ReplaceFalseWithTrue",
    "ReplaceUnaryOperator_Delete_Invert",
    "ReplaceUnaryOperator_Delete_Not",
    "ReplaceUnaryOperator_Delete_USub",
    *(f"ReplaceComparisonOperator_{pair}" for pair in ("Lt_GtE", "GtE_Lt", "Gt_LtE", "LtE_Gt", "Eq_NotEq", "NotEq_Eq")),
    *(f"ReplaceComparisonOperator_{pair}" for pair in ("Is_IsNot", "IsNot_Is")),
    *(f"ReplaceBinaryOperator_{pair}" for pair in ("Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "Pow_Mul")),
    *(f"ReplaceBinaryOperator_{pair}" for pair in ("FloorDiv_Mul", "Mod_Mul", "BitAnd_BitOr", "BitOr_BitAnd")),
)


class NumberBesideIt(NumberReplacer):
    """Plus and minus one, for small numbers only, since a change of 1000 by one has no effect."""

    def mutation_positions(self, node: parso.tree.NodeOrLeaf) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
        if isinstance(node, parso.python.tree.Number) and abs(ast.literal_eval(node.value)) <= LARGEST_SMALL_NUMBER:
            yield from super().mutation_positions(node)


class NumberToZero(Operator):
    """A weight or threshold set to zero."""

    def mutation_positions(self, node: parso.tree.NodeOrLeaf) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
        if isinstance(node, parso.python.tree.Number) and ast.literal_eval(node.value) not in (0, 1):
            yield node.start_pos, node.end_pos

    def mutate(self, node: parso.python.tree.Number, index: int) -> parso.tree.NodeOrLeaf:
        return parso.python.tree.Number(f"{node.prefix}0", node.start_pos)

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        return (Example("x = 0.3", "x = 0"),)


OF_NUMBERS: dict[str, type[Operator]] = {"one beside": NumberBesideIt, "zero": NumberToZero}


@dataclass(frozen=True)
class Mutant:
    """A module with one change.

    Attributes:
        module: its path from the root.
        line: the changed line.
        code: the code of the whole module.
        change: the changed lines, before and after.
    """

    module: str
    line: int
    code: str
    change: str


@dataclass(frozen=True)
class Tests:
    """The tests of a module's mutants.

    Attributes:
        names: files and tests, as arguments of pytest.
        seconds: their total time; None if they do not pass.
        left_out: number of tests that are too slow.
    """

    names: tuple[str, ...]
    seconds: float | None
    left_out: int


def main() -> None:
    arguments = parse(sys.argv[1:])
    with tempfile.TemporaryDirectory() as folder:
        copies = [copy_of_tree(Path(folder) / str(number)) for number in range(arguments.jobs)]
        tally: dict[str, Counter[bool]] = {}
        for module, line in modules_of(arguments.places):
            tests = tests_of(module, copies[0], arguments.slowest)
            if tests.seconds is None:
                say(f"{module}: no test is near it that passes and takes at most {arguments.slowest:g} s")
                continue
            left_out = f", {tests.left_out} left out" * bool(tests.left_out)
            say(f"{module}: {tests.seconds:.0f} s of tests{left_out}")
            code = (ROOT / module).read_text(encoding="utf-8")
            sample = arguments.sample if line is None else None
            chosen = chosen_mutants(module, code, sample, arguments.seed, line)
            tally[module] = try_mutants(chosen, tests.names, START + TIMES_AS_LONG * tests.seconds, copies)
    say("\n  killed  module")
    for module, count in [*tally.items(), ("in all", sum(tally.values(), Counter[bool]()))]:
        say(f"{count[True]:4d}/{count.total():<4d} {module}")


def parse(words: Sequence[str]) -> argparse.Namespace:
    summary = (__doc__ or "").partition("\n")[0]
    parser = argparse.ArgumentParser(prog="make mutants", description=summary)
    parser.add_argument("places", nargs="+", help="folders, modules, or lines of modules (MODULE:LINE)")
    parser.add_argument("--sample", type=int, default=8, help="mutants of each module (default: 8)")
    parser.add_argument("--seed", type=int, default=0, help="of the draw (default: 0)")
    parser.add_argument("--slowest", type=float, default=1.0, help="seconds that a test may take (default: 1)")
    parser.add_argument("--jobs", type=int, default=1, help="mutants that are tried at once (default: 1)")
    return parser.parse_args(words)


def say(message: str) -> None:
    print(message, flush=True)


def copy_of_tree(folder: Path) -> Path:
    shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(*NOT_COPIED))
    return folder


def modules_of(places: Sequence[str]) -> list[tuple[str, int | None]]:
    """The modules in some folders by their paths from the root, each with a line if one is given."""
    found: list[tuple[str, int | None]] = []
    for place in places:
        name, _, line = place.partition(":")
        path = (ROOT / name).resolve()
        if not path.exists() or not path.is_relative_to(ROOT):
            sys.exit(f"{name} is no folder and no module of this tree.")
        modules = [path] if path.is_file() else sorted(path.rglob("*.py"))
        found += [(str(module.relative_to(ROOT)), int(line) if line else None) for module in modules]
    return found


def nearest_tests(module: str, root: Path = ROOT) -> list[str]:
    """The test files that import a module or are named after it; otherwise those in the corresponding folder."""
    path = Path(module).with_suffix("")
    dotted, of_core = ".".join(path.parts), path.parts[0] == "zoomout_core"
    own, folders = root / "tests" / ("core" if of_core else ""), ("core" if of_core else "**", *path.parts[1:-1])
    imports = re.compile(
        rf"{re.escape(dotted)}\b|from {re.escape(dotted.rpartition('.')[0])} import [^\n]*\b{path.name}\b"
    )
    everything = sorted((root / "tests").rglob("test_*.py"))
    near = [
        file
        for file in everything
        if (file.stem.startswith(f"test_{path.name}") and file.is_relative_to(own))
        or imports.search(file.read_text(encoding="utf-8"))
    ]
    while not near and folders:
        near = sorted(root.glob("/".join(("tests", *folders, "test_*.py"))))
        folders = folders[:-1]
    return [str(file.relative_to(root)) for file in near]


def tests_of(module: str, copy: Path, slowest: float) -> Tests:
    """The tests near a module, quick files first, without those that are slow."""
    timed = [(file, durations(file, copy)) for file in nearest_tests(module, copy)]
    quick = [(file, {name: t for name, t in times.items() if t <= slowest}) for file, times in timed]
    quick = sorted(((file, times) for file, times in quick if times), key=lambda each: sum(each[1].values()))
    names = [name for _, times in quick for name in times]
    left_out = sum(len(times) for _, times in timed) - len(names)
    begin = time.monotonic()
    # Once more with the chosen tests alone: a fixture that a slow test has set up before is now set up by them.
    passed = bool(names) and pytest(names, copy, None)
    return Tests(tuple(names), time.monotonic() - begin if passed else None, left_out)


def durations(file: str, copy: Path) -> dict[str, float]:
    """Seconds that each test of a file takes, fixtures and all; only of those that pass without a mutant."""
    digest = hashlib.sha256((copy / file).read_bytes()).hexdigest()
    known = json.loads(DURATIONS.read_text()) if DURATIONS.exists() else {}
    if known.get(file, {}).get("digest") != digest:
        report = copy / "report.xml"
        pytest([file, f"--junitxml={report}", "-o", "junit_family=xunit1"], copy, None)
        cases = ElementTree.parse(report).iter("testcase")
        good = [case for case in cases if not any(child.tag in ("failure", "error", "skipped") for child in case)]
        seconds = {f"{file}::{case.get('name')}": float(case.get("time", 0)) for case in good}
        known[file] = {"digest": digest, "seconds": seconds}
        DURATIONS.parent.mkdir(exist_ok=True)
        DURATIONS.write_text(json.dumps(known, indent=1))
    found: dict[str, float] = known[file]["seconds"]
    return found


def pytest(arguments: Sequence[str], copy: Path, seconds: float | None) -> bool:
    """Whether tests pass in a copy of the tree, within a time limit."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *arguments]
    if seconds is None:
        command.remove("-x")
    environment = os.environ | {"PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, timeout=seconds)
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def chosen_mutants(module: str, code: str, sample: int | None, seed: int, line: int | None) -> list[Mutant]:
    """Some mutants of a module in the order of its lines; all mutants of a line if one is given."""
    found = [each for each in mutations(code) if line is None or each[2] == line]
    if sample is not None and len(found) > sample:
        found = random.Random(f"{seed} {module}").sample(found, sample)
    return [
        mutant
        for operator, occurrence, at in sorted(found, key=lambda each: each[2])
        if (mutant := _mutant(module, code, operator, occurrence, at)) is not None
    ]


def mutations(code: str) -> list[tuple[str, int, int]]:
    """The possible changes of a module: the operator, the index of its occurrence, and the line."""
    tree, silent = get_ast(code), list(_without_effect(code))
    return [
        (operator, occurrence, start[0])
        for operator in (*OF_NUMBERS, *OPERATORS)
        for occurrence, start in enumerate(
            start for node in ast_nodes(tree) for start, _ in _operator(operator).mutation_positions(node)
        )
        if not any(begin <= start < end for begin, end in silent)
    ]


def _operator(name: str) -> Operator:
    return OF_NUMBERS[name]() if name in OF_NUMBERS else get_operator(f"core/{name}")()


def _without_effect(code: str) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Lines with types, which are not evaluated, with decorators, such as frozen dataclasses', and with ranges.

    The ranges of tuned numbers exclude only meaningless values. `reshape` treats all negative numbers alike, and
    others rarely fit.
    """
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "reshape":
            for size in node.args:
                if isinstance(size, ast.UnaryOp) and isinstance(size.op, ast.USub):
                    yield (size.lineno, size.col_offset), (size.end_lineno or 0, size.end_col_offset or 0)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "tuned":
            for bound in node.args[2:]:
                yield (bound.lineno, bound.col_offset), (bound.end_lineno or 0, bound.end_col_offset or 0)
        for decorator in getattr(node, "decorator_list", ()):
            yield (decorator.lineno, decorator.col_offset), (decorator.end_lineno, decorator.end_col_offset)
        for name in ("annotation", "returns"):
            kind = getattr(node, name, None)
            if isinstance(kind, ast.expr):
                yield (kind.lineno, kind.col_offset), (kind.end_lineno or 0, kind.end_col_offset or 0)


def _mutant(module: str, code: str, operator: str, occurrence: int, line: int) -> Mutant | None:
    changed = mutate_code(code, _operator(operator), occurrence)
    if changed is None or changed == code:
        return None
    difference = islice(unified_diff(code.splitlines(), changed.splitlines(), n=0, lineterm=""), 3, None)
    change = "\n".join(f"    {text[0]} {text[1:].strip()}" for text in difference if text[0] in "+-")
    return Mutant(module, line, changed, change)


def try_mutants(
    mutants: Sequence[Mutant], tests: Sequence[str], seconds: float, copies: Sequence[Path]
) -> Counter[bool]:
    """Print the result of each mutant, and return the numbers of killed and of surviving ones."""
    free: Queue[Path] = Queue()
    for copy in copies:
        free.put(copy)

    def is_killed(mutant: Mutant) -> bool:
        copy = free.get()
        file, begin = copy / mutant.module, time.monotonic()
        original = file.read_bytes()
        try:
            file.write_text(mutant.code, encoding="utf-8")
            dead = not pytest(tests, copy, seconds)
        finally:
            file.write_bytes(original)
            free.put(copy)
        how = "killed  " if dead else "SURVIVED"
        say(f"  {how} {mutant.module}:{mutant.line} ({time.monotonic() - begin:.0f} s)\n{mutant.change}")
        return dead

    with ThreadPoolExecutor(len(copies)) as pool:
        return Counter(pool.map(is_killed, mutants))


if __name__ == "__main__":
    main()
