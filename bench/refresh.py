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

FOLDERS = ("real", "clips", "base")
"""Kinds of data that are given as a folder, by option."""


def main(argv: Sequence[str]) -> int:
    """Measure, write the results and the pages; return the exit status."""
    given = _parse(argv)
    rows = figures.read()
    stale = [
        row
        for row in rows
        if (given.only in row.command if given.only else given.all)
        or (not given.only and figures.age(row.commit) > AGE_COMMITS_MAX)
    ]
    if given.check:
        for row in stale:
            print(f"{figures.age(row.commit)} commits ago: {row.what}")
        return 1 if stale else 0

    # Each command once.
    commit = _git("rev-parse", "--short=7", "HEAD")
    status = 0
    for command in dict.fromkeys(row.command for row in stale):
        of_command = [row for row in stale if row.command == command and row.template]
        folder = getattr(given, of_command[0].data, None) if of_command else None
        if not of_command or (of_command[0].data in FOLDERS and folder is None):
            why = DATA[of_command[0].data] if of_command else "renewed by hand"
            print(f"left out ({why}): {command}")
            continue
        if not measure(command.replace("FOLDER", str(folder)), of_command, commit):
            status = 1
    figures.write(rows)
    figures.write_pages(rows)
    return status


def measure(command: str, rows: Sequence[Row], commit: str) -> bool:
    """Run a command and renew its rows in place; return True if all figures were printed."""
    began = time.monotonic()
    printed = figures.run(command)
    minutes = (time.monotonic() - began) / 60.0
    for row in rows:
        try:
            row.figure = figures.filled(row.template, printed)
        except KeyError as error:
            print(f"no figure {error}: {row.what}", file=sys.stderr)
            return False
        row.commit, row.date = commit, datetime.date.today().isoformat()
        row.minutes = round(minutes, 1)
        print(f"  {row.what}: {row.figure}", flush=True)
    return True


def _git(*arguments: str) -> str:
    return subprocess.check_output(["git", *arguments], cwd=figures.ROOT, text=True).strip()


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m bench refresh", description="Measure again what the pages show."
    )
    parser.add_argument("--check", action="store_true", help="only list what is too old")
    parser.add_argument("--all", action="store_true", help="measure every row")
    parser.add_argument("--only", metavar="WORD", help="measure the commands that have this word")
    for name in FOLDERS:
        parser.add_argument(f"--{name}", metavar="FOLDER", help=DATA[name])
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
