"""What pages show: the commands among their lines."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

FENCED = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
"""A block's language and its lines."""


def invocations(line: str) -> Iterator[list[str]]:
    """What a line of a shell gives to camtopod: here, in a container, or as systemd does."""
    words = shlex.shlex(line, posix=True, punctuation_chars=True)
    words.whitespace_split = True
    command: list[str] = []
    for word in [*words, ";"]:
        if not set(word) <= set(";&|()<>"):
            command.append(word.removeprefix("ExecStart="))
            continue
        if command and Path(command[0]).name == "camtopod":
            yield command[1:]
        elif command[:2] == ["docker", "run"] and "camtopod" in command:
            yield command[command.index("camtopod") + 1 :]
        elif command[:2] == ["docker", "compose"] and "run" in command:
            yield command[command.index("--rm") + 2 :]
        elif command[:1] == ["kubectl"] and "--" in command:
            yield command[command.index("--") + 2 :]
        command = []
