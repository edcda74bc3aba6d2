"""The completion scripts in their shells."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from camtopod.cli.commands.completion import SHELLS
from camtopod.cli.main import COMMANDS, main

BASH = """
source "$1"; shift
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMP_LINE="$*"; COMP_POINT=${#COMP_LINE}
complete -p camtopod | grep -q -- '-F _shtab_camtopod' || exit 3
_shtab_camtopod camtopod "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD - 1]}"
printf '%s\\n' "${COMPREPLY[@]}"
"""
FISH = 'source $argv[1]; complete -C "$argv[2]" | string replace -r "\\t.*" ""'
ZSH = """
zmodload zsh/zpty
zpty z zsh -f -i
zpty -w z "PS1='' ; fpath=($1 \\$fpath); autoload -U compinit; compinit -D -u"
zpty -w z "bindkey '^I' list-choices; echo BEGIN''NING"
zpty -r z seen '*BEGINNING*'
zpty -n -w z "$2"$'\\t'
zpty -r -m z seen "*$3*" && print -r -- "$seen"
zpty -d z
"""


@pytest.fixture
def of(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Callable[[str], Path]:
    """Return the file that the command writes for a shell; skip the test without that shell."""

    def write(shell: str) -> Path:
        if shutil.which(shell) is None:
            pytest.skip(f"no {shell}")
        assert main(["completion", shell]) == 0
        path = tmp_path / "_camtopod"
        path.write_text(capsys.readouterr().out)
        return path

    return write


def output(*command: str | Path, cwd: Path) -> list[str]:
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, cwd=cwd)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.split()


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("", {*COMMANDS}),
        ("gr", {"grab"}),
        ("grab --sp", {"--speed"}),
        (
            "check --",
            {
                "--example",
                "--schema",
                "--help",
                "--config",
                "--site",
                "--connect",
                "--log-format",
                "--log-level",
            },
        ),
        ("--log-format ", {"text", "logfmt", "json"}),
        ("ingest fr", {"frigate"}),
        ("export t.json --format ", {"dot", "graphml", "svg", "json", "aicity"}),
        ("keys re", {"reader", "revoke"}),
        ("keys camera --", {"--for", "--days", "--replace", "--keys", "--help"}),
        ("--config eve", {"events.jsonl"}),
        ("learn eve", {"events.jsonl"}),
        ("init lobby=0 eve", {"events.jsonl"}),
    ],
)
def test_bash(typed: str, offered: set[str], of: Callable[[str], Path], tmp_path: Path) -> None:
    (tmp_path / "events.jsonl").touch()
    words = ["camtopod", *typed.split(" ")]
    found = output("bash", "--norc", "-c", BASH, "bash", of("bash"), *words, cwd=tmp_path)
    assert offered <= set(found)
    assert all(word.startswith(words[-1]) for word in found)


@pytest.mark.parametrize(
    ("typed", "offered"),
    [("", {*COMMANDS}), ("grab --sp", {"--speed"}), ("ingest fr", {"frigate"})],
)
def test_fish(typed: str, offered: set[str], of: Callable[[str], Path], tmp_path: Path) -> None:
    found = output("fish", "--no-config", "-c", FISH, of("fish"), f"camtopod {typed}", cwd=tmp_path)
    assert offered <= set(found)
    assert all(word.startswith(typed.split(" ")[-1]) for word in found)


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("grab --re", "--realtime"),
        ("keys re", "revoke"),
        ("learn eve", "events.jsonl"),
        ("learn first.jsonl eve", "events.jsonl"),
        ("init hall=0 eve", "events.jsonl"),
    ],
)
def test_zsh(typed: str, offered: str, of: Callable[[str], Path], tmp_path: Path) -> None:
    for name in ("events.jsonl", "events.csv"):
        (tmp_path / name).touch()
    folder = of("zsh").parent
    seen = output("zsh", "-f", "-c", ZSH, "zsh", folder, f"camtopod {typed}", offered, cwd=tmp_path)
    assert offered in " ".join(seen)


@pytest.mark.parametrize("shell", SHELLS)
def test_a_shell_can_read_it(shell: str, of: Callable[[str], Path], tmp_path: Path) -> None:
    output(shell, "-n", of(shell), cwd=tmp_path)
