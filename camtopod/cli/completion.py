"""The option ``--print-completion SHELL``: a script by shtab, of the extra ``[terminal]``."""

from __future__ import annotations

import argparse
import re
from typing import Any

SHELLS = ("bash", "zsh", "fish", "tcsh")
"""Shells for which there are scripts."""
_PATHS = re.compile("FILE|FOLDER|DIR|SOURCE|CONFIG|EVENTS|json")
"""Part of the name of a value that is completed with files."""


def script(parser: argparse.ArgumentParser, shell: str) -> str:
    """Return the completion script of ``parser`` for ``shell``."""
    import shtab

    _complete_paths(parser, shtab.FILE)
    return str(shtab.complete(parser, shell))


def _complete_paths(parser: argparse.ArgumentParser, completer: Any) -> None:
    """Set the completer of every value of ``parser`` and its commands that names a path."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                _complete_paths(command, completer)
        elif _PATHS.search(str(action.metavar)):
            action.complete = completer  # type: ignore[attr-defined]
