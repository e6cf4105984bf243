# SPDX-License-Identifier: GPL-3.0-or-later
"""Commands explain missing packages, and print the version."""

from __future__ import annotations

import subprocess
import sys

import click
import pytest
from click.testing import CliRunner

import zoomout_core as zo
from zoomout_core.cli import SUMMARIES, main


@pytest.mark.parametrize(
    ("module", "missing", "extra", "command"),
    [
        ("zoomout_core", "click", "cli", []),
        ("zoomout_core", "tqdm", "cli", ["match"]),
        ("meshlab_filter", "click", "meshlab", []),
    ],
)
def test_missing_package_error_names_the_extra(module: str, missing: str, extra: str, command: list[str]) -> None:
    without = f"import sys, runpy; sys.modules[{missing!r}] = None; runpy.run_module({module!r}, run_name='__main__')"
    done = subprocess.run(
        [sys.executable, "-c", without, *command, "--help"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert done.stderr.strip().endswith(f"is missing: in the checkout, pip install '.[{extra}]'.")
    assert len(done.stderr.strip().splitlines()) == 1


def test_every_command_has_a_json_option() -> None:
    for name in SUMMARIES:
        assert "--json" in {option for param in command_of(name).params for option in param.opts}, name


def test_command_runs_as_a_module() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "zoomout_core", "--version"], capture_output=True, text=True, check=True
    )
    assert zo.__version__ in done.stdout
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = zo.nothing


def test_list_of_commands_shows_full_summaries() -> None:
    listed = CliRunner().invoke(main, ["--help"], terminal_width=80).output.partition("Commands:")[2]
    for name in SUMMARIES:
        assert name in listed
        assert SUMMARIES[name] == command_of(name).get_short_help_str(limit=80)
    assert "..." not in listed


def test_help_does_not_need_numpy() -> None:
    without = "import sys, runpy; sys.modules['numpy'] = None; runpy.run_module('zoomout_core', run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", without, "--help"], capture_output=True, text=True, check=True)
    assert "Commands:" in done.stdout


def command_of(name: str) -> click.Command:
    """A command of `zoomout`."""
    command = main.get_command(click.Context(main), name)
    assert command is not None
    return command
