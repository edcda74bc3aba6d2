"""The option ``--print-completion SHELL``: a script by shtab, of the extra ``[terminal]``."""

from __future__ import annotations

import argparse
from typing import Any

from camtopod.cli import exits

SHELLS = ("bash", "zsh", "fish", "tcsh")
"""Shells for which there are scripts."""
_FILES = (
    "FILE",
    "CONFIG",
    "SOURCE",
    "[NAME=]SOURCE",
    "EVENTS",
    "TOPOLOGY.json",
    "OUT.json",
    "OUT.jsonl",
    "E.jsonl",
    "T.json",
)
"""Names of values that are completed with files."""
_FOLDERS = ("DIR", "DIRECTORY", "FOLDER")
"""Names of values that are completed with folders."""


def script(parser: argparse.ArgumentParser, shell: str) -> str:
    """Return the completion script of ``parser`` for ``shell``.

    Raises `CommandError` if shtab is not installed.
    """
    try:
        import shtab
    except ModuleNotFoundError:
        raise exits.CommandError(
            "--print-completion needs the package 'shtab', which is not installed; "
            "see README, 'Packages'"
        ) from None

    _mark_paths(
        parser, {**dict.fromkeys(_FILES, shtab.FILE), **dict.fromkeys(_FOLDERS, shtab.DIRECTORY)}
    )
    return str(shtab.complete(parser, shell))


def _mark_paths(parser: argparse.ArgumentParser, completers: dict[str, Any]) -> None:
    """Set the completer of every value of ``parser`` and its commands that names a path."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                _mark_paths(command, completers)
        elif isinstance(action.metavar, str) and action.metavar in completers:
            action.complete = completers[action.metavar]  # type: ignore[attr-defined]
