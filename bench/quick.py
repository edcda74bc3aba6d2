"""Measure the rows of README's table on smaller inputs, within minutes, beside README's figures.

    python -m bench quick

All data is simulated, so that nothing has to be downloaded. Rows that take long, such as thirty
kills, are named and not measured.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from bench.support import figures


def main(argv: Sequence[str]) -> int:
    """Print a line for each row; return 1 if a command did not print its figures."""
    if argv:
        print("usage: python -m bench quick", file=sys.stderr)
        return 2
    rows = [row for row in figures.read() if row.readme and not row.data]
    printed = {command: figures.run(command) for command in {row.quick for row in rows} if command}
    status = 0
    for row in rows:
        try:
            text = figures.filled(row.template, printed[row.quick]) if row.quick else "takes long"
        except KeyError:
            text, status = "failed", 1
        print(f"{row.readme}\n    here {text:32}README {row.figure}")
    return status
