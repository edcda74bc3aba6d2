"""Writes the files that are made from the program's own commands, settings and templates; run it
after changing one of them.

    .venv/bin/python deploy/generate.py

Needs the extra [test]. What is written by hand, the manual page, is so because argparse-manpage
repeats the common options below each command and knows no exit statuses.
"""

from __future__ import annotations

import argparse
import textwrap
from pathlib import Path

from bench.support import figures
from camtopod import __version__
from camtopod.cli.city import deployment
from camtopod.cli.generated import example, schema_text
from camtopod.cli.main import COMMANDS, parser_of
from camtopod.config import Limits

ROOT = Path(__file__).parent.parent
_DATE = "2026-11-22"
"""Of the manual page; another one would make every day's page another."""
_STATUSES = {
    0: "done",
    1: "failed",
    2: "the command line is wrong",
    66: "an input cannot be read",
    69: "the bus cannot be reached",
    74: "the state directory cannot be written",
    78: "the configuration is wrong",
}
SITE = {
    **deployment.demand(Limits().cameras_max),
    "SITE": "SITE",
    "DAEMON": "camtopod",
    "ROUTER": "camtopod-router",
    "LISTEN": "tcp/0.0.0.0:7447",
    "HEAD": "# The daemon: one per site. systemctl enable --now camtopod\n"
    "# With certificates: cp -r deploy/camtopod.service.d /etc/systemd/system/, see security.md.",
    "TITLE": "camtopod daemon",
    "AFTER": "",
    "DAEMON_CONFIG": "camtopod",
    "USER": "User=camtopod\n",
    "STATE": "camtopod",
    "GRABBER": "camtopod-grab",
    "CONFIG": "camtopod",
}
"""What the templates of deployments have for a single site."""


def files() -> dict[Path, str]:
    """Every file with what belongs into it."""
    deploy = ROOT / "deploy"
    return {
        **figures.pages(figures.read()),
        deploy / "camtopod.toml": example(),
        deploy / "camtopod.schema.json": schema_text("configuration"),
        deploy / "camtopod.1": manual(),
        deploy / "camtopod.service": deployment.filled("daemon.service", **SITE),
        deploy / "camtopod-grab@.service": deployment.filled("grabber.service", **SITE),
        deploy / "router.json5": deployment.filled("router.json5", **SITE),
        deploy / "kubernetes.yaml": deployment.filled("kubernetes.yaml", **SITE),
    }


def manual() -> str:
    """The manual page, in man(7)."""
    parser, _ = parser_of(COMMANDS)
    common, commands = _groups(parser)["common options"], _commands(parser)
    lines = [
        f'.TH CAMTOPOD 1 {_DATE} "camtopod {__version__}"',
        ".SH NAME",
        r"camtopod \- learns the topology of a camera network",
        ".SH SYNOPSIS",
        r"\fBcamtopod\fR [\fIOPTION\fR]... \fICOMMAND\fR [\fIOPTION\fR]...",
        *_section("DESCRIPTION", str(parser.description)),
        *_section("COMMON OPTIONS", "They stand before or after the command."),
        *(line for action in common for line in _option(action)),
        ".SH COMMANDS",
        *(line for command in commands for line in _command(command)),
        ".SH EXIT STATUS",
        *(line for status, meaning in _STATUSES.items() for line in (".TP", str(status), meaning)),
        *_section(
            "SEE ALSO",
            "camtopod check --example writes a configuration with every setting and its meaning.",
        ),
    ]
    return "\n".join(lines) + "\n"


def _section(title: str, text: str) -> list[str]:
    return [f".SH {title}", *_text(text)]


def _command(parser: argparse.ArgumentParser) -> list[str]:
    """A command with what belongs to it alone, and then its own commands."""
    named = [
        action for action in parser._actions if not action.option_strings and not _inner(action)
    ]
    groups = {
        title: actions for title, actions in _groups(parser).items() if title != "common options"
    }
    lines = [
        f".SS {parser.prog}{''.join(f' {_usage(action)}' for action in named)}",
        *_text(str(parser.description)),
    ]
    lines += [line for actions in groups.values() for action in actions for line in _option(action)]
    return lines + [line for inner in _commands(parser) for line in _command(inner)]


def _groups(parser: argparse.ArgumentParser) -> dict[str | None, list[argparse.Action]]:
    """What a person is told of, by the group's title."""
    hidden = (argparse._HelpAction, argparse._SubParsersAction)
    return {
        group.title: [
            a
            for a in group._group_actions
            if a.help != argparse.SUPPRESS and not isinstance(a, hidden)
        ]
        for group in parser._action_groups
    }


def _inner(action: argparse.Action) -> bool:
    return isinstance(action, argparse._SubParsersAction)


def _commands(parser: argparse.ArgumentParser) -> list[argparse.ArgumentParser]:
    """The commands below a parser, with the description they have or the help of the parser
    above.
    """
    found = []
    for action in filter(_inner, parser._actions):
        for listed in action._choices_actions:
            inner = action.choices[listed.dest]
            inner.description = inner.description or f"{listed.help.capitalize()}."
            found.append(inner)
    return found


def _option(action: argparse.Action) -> list[str]:
    names = ", ".join(rf"\fB{_escaped(name)}\fR" for name in action.option_strings)
    value = _usage(action) if action.nargs != 0 else ""
    help_ = str(action.help or "") % {**vars(action), "prog": "camtopod"}
    return [".TP", " ".join(filter(None, (names, value))), *_text(help_)]


def _usage(action: argparse.Action) -> str:
    """The value of an option, or an argument, as in a usage line."""
    name = action.metavar or (
        "|".join(map(str, action.choices)) if action.choices else action.dest.upper()
    )
    names = name if isinstance(name, tuple) else (str(name),)
    shown = " ".join(rf"\fI{_escaped(word)}\fR" for word in names)
    if action.option_strings:
        return shown
    return {"?": f"[{shown}]", "*": f"[{shown}]...", "+": f"{shown}..."}.get(
        str(action.nargs), shown
    )


def _text(text: str) -> list[str]:
    lines = textwrap.wrap(_escaped(text), 79, break_long_words=False, break_on_hyphens=False)
    return [rf"\&{line}" if line[0] in ".'" else line for line in lines]


def _escaped(text: str) -> str:
    return text.replace("\\", r"\e").replace("-", r"\-").replace("`", "")


if __name__ == "__main__":
    for path, content in files().items():
        path.write_text(content, encoding="utf-8")
