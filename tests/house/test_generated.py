"""Generated files are up to date, and the manual page is valid."""

from __future__ import annotations

import argparse
import runpy
import shutil
import subprocess
from pathlib import Path

import pytest
from paths import DEPLOY

from camtopod.cli.main import COMMANDS, parser_of

FILES = runpy.run_path(str(DEPLOY / "generate.py"))["files"]()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_it_is_current(path: Path) -> None:
    assert path.read_text(encoding="utf-8") == FILES[path], "python deploy/generate.py"


def test_the_manual_has_every_command_and_every_option() -> None:
    page = (DEPLOY / "camtopod.1").read_text().replace(r"\-", "-")
    parser, _ = parser_of(COMMANDS)
    [commands] = [
        action for action in parser._actions if isinstance(action, argparse._SubParsersAction)
    ]
    for name, command in commands.choices.items():
        assert f"\n.SS camtopod {name}" in page
        for action in command._actions:
            if action.help != argparse.SUPPRESS and not isinstance(action, argparse._HelpAction):
                assert all(rf"\fB{option}\fR" in page for option in action.option_strings), (
                    name,
                    action.dest,
                )


@pytest.mark.parametrize("reader", ["mandoc -T lint", "groff -man -ww -T utf8 -z"])
def test_a_reader_of_manuals_has_nothing_to_say(reader: str) -> None:
    command = reader.split()
    if shutil.which(command[0]) is None:
        pytest.skip(f"no {command[0]}")
    done = subprocess.run([*command, str(DEPLOY / "camtopod.1")], capture_output=True, text=True)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")
