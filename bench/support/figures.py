"""The figures that README and bench/README show, with the commands that measured them.

`results.json` has them, a `Row` each; `tables` writes the tables of both pages. A part of the bench
prints a figure as a line, ``figure: NAME = VALUE ± STANDARD ERROR`` (`line_of`), from which
`python -m bench refresh` renews the rows that name it in their ``template``. Rows without a
template are renewed by hand.
"""

from __future__ import annotations

import math
import re
import shlex
import subprocess
import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
from msgspec import Struct

ROOT = Path(__file__).parent.parent.parent
RESULTS = ROOT / "bench" / "results.json"
AGE_COMMITS_MAX = 200
"""Age from which a row is to be measured again; a release has no older one."""
SECTIONS = ("The learner", "The daemon", "Faults", "The grabber")
"""Headings of the tables, in order."""
MECHANISMS = {
    "Mechanisms of the learner": ("log loss", "links", "false links"),
    "Mechanisms of the grabber": ("F1", "false events"),
}
"""Headings of the tables of what mechanisms are worth, each measured by one command, and columns.
"""
_LINE = re.compile(r"^figure: (?P<name>.+?) = (?P<value>\S+)(?: ± (?P<error>\S+))?$")


class Figure(NamedTuple):
    """A measured value; ``error`` is its standard error, nan if there is none."""

    value: float
    error: float = math.nan

    def __format__(self, spec: str) -> str:
        """Format the value, followed by the standard error in brackets, if there is one."""
        error = "" if math.isnan(self.error) else f" ({format(self.error, spec.lstrip('+'))})"
        return format(self.value, spec) + error


class Row(Struct, omit_defaults=True):
    """One row of the tables.

    section: one of `SECTIONS` and `MECHANISMS`.
    what: what is measured.
    figure: the figures, in words.
    command: command that measures it; FOLDER stands for a folder of ``data``.
    data: what the command needs that is not made by it: a key of `DATA`; "" for nothing.
    minutes: how long it took; 0 if it was not noted.
    commit, date: commit that was measured, and the day.
    machine: on what it was measured.
    template: ``figure`` with the names of printed figures in braces.
    readme: what is measured, in README's words; "" for rows that README does not have.
    quick: a command that prints the same figures of less, within seconds; "" if there is none.
    """

    section: str
    what: str
    figure: str
    command: str
    commit: str
    date: str
    data: str = ""
    minutes: float = 0.0
    machine: str = "two shared x86-64 cores"
    template: str = ""
    readme: str = ""
    quick: str = ""


DATA = {
    "": "none",
    "base": "a checkout of commit 8efac5f",
    "real": "the recordings with identities",
    "clips": "the clips with truths",
    "opencv-doc": "Debian's opencv-doc",
    "model": "the clips, and a detector's ONNX file",
}
"""Data that commands need, in words; bench/README names the sources."""


def line_of(name: str, value: float, error: float = math.nan) -> str:
    """Return the line in which a part of the bench prints a figure."""
    return f"figure: {name} = {value:.6g}" + ("" if math.isnan(error) else f" ± {error:.3g}")


def read_lines(lines: Iterable[str]) -> dict[str, Figure]:
    """Return the figures that a part has printed, by name."""
    matches = filter(None, map(_LINE.match, lines))
    return {
        match["name"]: Figure(float(match["value"]), float(match["error"] or "nan"))
        for match in matches
    }


def run(command: str) -> dict[str, Figure]:
    """Run a command in this checkout, and show it; return the figures that it has printed."""
    print(f"$ {command}", flush=True)
    words = [sys.executable, *shlex.split(command)[1:]]
    process = subprocess.run(words, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    figures = read_lines(process.stdout.splitlines())
    if process.returncode or not figures:
        print(f"{process.stdout}\nstatus {process.returncode}", file=sys.stderr)
    return figures


def filled(template: str, figures: Mapping[str, Figure]) -> str:
    """Return a row's figures in words; raise KeyError for a figure that was not printed."""
    return re.sub(
        r"\{(.+?)(?::([^:{}]*))?\}", lambda hole: format(figures[hole[1]], hole[2] or ""), template
    )


def read() -> list[Row]:
    """Return all rows."""
    return msgspec.json.decode(RESULTS.read_bytes(), type=list[Row])


def write(rows: Sequence[Row]) -> None:
    """Write all rows."""
    RESULTS.write_bytes(msgspec.json.format(msgspec.json.encode(rows), indent=1) + b"\n")


def age(commit: str) -> int:
    """Return the number of commits since one.

    Raise CalledProcessError where the history does not have it.
    """
    count = ["git", "rev-list", "--count", f"{commit}..HEAD"]
    return int(subprocess.check_output(count, cwd=ROOT, text=True))


def tables(rows: Sequence[Row]) -> dict[str, str]:
    """Return the tables of bench/README by section, and the table and the list of README.

    README's table has what every reader can measure, its list what needs data.
    """
    head = ["| what | figure | command | data | minutes | commit |", "|" + " --- |" * 6]
    texts = {
        section: "\n".join([*head, *(_line(row) for row in rows if row.section == section)])
        for section in SECTIONS
    }
    for section, columns in MECHANISMS.items():
        mechanisms = [row for row in rows if row.section == section]
        if mechanisms:
            lines = [f"| {row.what} | {row.figure.replace('; ', ' | ')} |" for row in mechanisms]
            head = [f"| without | {' | '.join(columns)} |", "|" + " --- |" * (1 + len(columns))]
            texts[section] = "\n".join([*head, *lines, "", _source(mechanisms[0])])
    head = ["| what | figure |", "|" + " --- |" * 2]
    lines = [f"| {row.readme} | {row.figure} |" for row in rows if row.readme and not row.data]
    texts["README"] = "\n".join([*head, *lines])
    texts["README, with data"] = "\n".join(
        textwrap.fill(f"- {row.readme}: {row.figure}", 100, subsequent_indent="  ")
        for row in rows
        if row.readme and row.data
    )
    return texts


def with_tables(page: str, texts: Mapping[str, str]) -> str:
    """Return a page with the tables between its marks ``<!-- figures: SECTION -->`` renewed."""
    for section, text in texts.items():
        begin, mark, tail = page.partition(f"<!-- figures: {section} -->\n")
        if mark:
            page = f"{begin}{mark}\n{text}\n\n<!-- end -->" + tail.partition("<!-- end -->")[2]
    return page


def _line(row: Row) -> str:
    """Return the row of a table of bench/README."""
    cells = (row.what, row.figure, f"`{row.command}`", DATA[row.data], _minutes(row), row.commit)
    return f"| {' | '.join(cells)} |"


def _source(row: Row) -> str:
    """Return how the rows of a table were measured that one command makes."""
    text = f"`{row.command}`, {DATA[row.data]}, {_minutes(row)} minutes, commit {row.commit}."
    return textwrap.fill(text, 100, break_on_hyphens=False)


def _minutes(row: Row) -> str:
    return f"{row.minutes:.0f}" if row.minutes >= 1 else "1" if row.minutes else "-"


def pages(rows: Sequence[Row]) -> dict[Path, str]:
    """Return README and bench/README with their tables renewed, by path."""
    texts = tables(rows)
    paths = (ROOT / "README.md", ROOT / "bench" / "README.md")
    return {path: with_tables(path.read_text(encoding="utf-8"), texts) for path in paths}


def write_pages(rows: Sequence[Row]) -> None:
    """Write the tables of README and bench/README."""
    for path, text in pages(rows).items():
        path.write_text(text, encoding="utf-8")
