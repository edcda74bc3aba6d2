"""The Markdown pages of the repository, and their commands, blocks and links."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

from paths import DEPLOY, ROOT, TESTS

PAGES = (
    ROOT / "README.md",
    *sorted(DEPLOY.rglob("*.md")),
    ROOT / "bench" / "README.md",
    TESTS / "README.md",
    TESTS / "examples" / "README.md",
    TESTS / "faults" / "README.md",
    ROOT / "camtopod" / "ARCHITECTURE.md",
    ROOT / "camtopod" / "learn" / "METHOD.md",
    ROOT / "camtopod" / "sim" / "auditorium" / "SOURCE.md",
)
"""All pages, the main one first."""
FENCED = re.compile(r"^ *```(\w*)\n(.*?)^ *```$", re.DOTALL | re.MULTILINE)
"""A fenced block: its language and its lines."""
SHELL = ("", "sh", "ini")
"""Languages of blocks whose lines may be commands."""
_HERE_DOCUMENT = re.compile(r"<<'END'\n.*?^END$", re.DOTALL | re.MULTILINE)
_QUOTED = re.compile(r"`([^`]+)`")
_LINK = re.compile(r"\]\(([^)\s]+)\)")


def blocks(text: str, language: str) -> list[str]:
    """Return the blocks of one language in a page."""
    return [block for found, block in FENCED.findall(text) if found == language]


def shown(text: str) -> list[str]:
    """Return every line of a page's shell blocks, every indented line, and every text between
    backquotes.
    """
    shell = "".join(block for language, block in FENCED.findall(text) if language in SHELL)
    prose = FENCED.sub("", text)
    indented = [line.strip() for line in prose.splitlines() if line.startswith("    ")]
    quoted = [" ".join(found.split()) for found in _QUOTED.findall(prose)]
    return [*_HERE_DOCUMENT.sub("", shell).splitlines(), *indented, *quoted]


def links(text: str) -> list[str]:
    """Return the targets of a page's links and pictures that are not addresses of other sites."""
    found = _LINK.findall(_QUOTED.sub("", FENCED.sub("", text)))
    return [target for target in found if not re.match(r"[a-z]+:", target)]


def invocations(line: str) -> Iterator[list[str]]:
    """Yield the arguments of each call of camtopod in a shell line.

    Calls may be direct, in a container or in a systemd unit.
    """
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
