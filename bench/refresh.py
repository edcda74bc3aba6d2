"""Measure again what README and bench/README show, and renew their tables.

    python -m bench refresh [--check] [--all] [--only WORD] [--real F] [--clips F] [--base F]

Without options, the rows of `results.json` that are older than 200 commits are measured, each
command once, in this checkout; with ``--only``, those whose command has the word; with ``--all``,
every one. Commands whose data is not given, and rows that are renewed by hand, are listed.
``--check`` measures nothing and ends with 1 if a row is too old: no release is made then.
"""

from __future__ import annotations

import argparse
import datetime
import subprocess
import sys
import time
from collections.abc import Sequence

from bench.support import figures
from bench.support.figures import AGE_COMMITS_MAX, DATA, Row
from bench.support.parts import part_parser

FOLDERS = ("real", "clips", "base")
"""Kinds of data that are given as a folder, by option."""


def main(argv: Sequence[str]) -> int:
    """Measure, write the results and the pages; return the exit status."""
    arguments = _parse(argv)
    stale = [row for row in figures.read() if _is_asked(row, arguments)]
    if arguments.check:
        for row in stale:
            print(f"{figures.age(row.commit)} commits ago: {row.what}")
        return 1 if stale else 0
    if _git("status", "--porcelain", "camtopod"):
        print("bench refresh: camtopod has changes; commit them, then measure", file=sys.stderr)
        return 2

    # Each command once. The rows are read anew, as another run may have renewed some meanwhile.
    commit = _git("rev-parse", "--short=7", "HEAD")
    status = 0
    for command in dict.fromkeys(row.command for row in stale):
        row = next(row for row in stale if row.command == command)
        folder = getattr(arguments, row.data, None)
        if not row.template or (row.data in FOLDERS and folder is None):
            print(f"left out ({DATA[row.data] if row.template else 'renewed by hand'}): {command}")
            continue
        start = time.monotonic()
        printed = figures.run(command.replace("FOLDER", str(folder)))
        minutes = (time.monotonic() - start) / 60.0
        rows = figures.read()
        of_command = [row for row in rows if row.command == command and row.template]
        try:
            texts = [figures.filled(row.template, printed) for row in of_command]
        except KeyError as error:
            print(f"no figure {error}", file=sys.stderr)
            status = 1
            continue
        for row, text in zip(of_command, texts, strict=True):
            row.figure, row.commit, row.minutes = text, commit, round(minutes, 1)
            row.date = datetime.date.today().isoformat()
            print(f"  {row.what}: {text}", flush=True)
        figures.write(rows)
        figures.write_pages(rows)
    return status


def _is_asked(row: Row, arguments: argparse.Namespace) -> bool:
    """Return True if a row is to be measured by the options."""
    if arguments.only:
        return arguments.only in row.command
    return arguments.all or figures.age(row.commit) > AGE_COMMITS_MAX


def _git(*arguments: str) -> str:
    return subprocess.check_output(["git", *arguments], cwd=figures.ROOT, text=True).strip()


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = part_parser(__name__, __doc__)
    parser.add_argument("--check", action="store_true", help="only list what is too old")
    parser.add_argument("--all", action="store_true", help="measure every row")
    parser.add_argument("--only", metavar="WORD", help="measure the commands that have this word")
    for name in FOLDERS:
        parser.add_argument(f"--{name}", metavar="FOLDER", help=DATA[name])
    return parser.parse_args(argv)
