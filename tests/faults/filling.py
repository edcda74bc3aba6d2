"""Write a journal or a spool while its files may not grow, and then when they may again.

Arguments: journal or spool, directory, most bytes of a file, steps. Prints how often a step was
refused.
"""

from __future__ import annotations

import json
import resource
import sqlite3
import sys
from pathlib import Path

from written import WrittenJournal, WrittenSpool

REFUSED = 20
"""Refusals after which the limit is raised."""


def main() -> None:
    """Write the steps, repeating refused ones; raise the limit after `REFUSED` refusals."""
    name, directory, limit, steps = (
        sys.argv[1],
        Path(sys.argv[2]),
        int(sys.argv[3]),
        int(sys.argv[4]),
    )
    one = {"journal": WrittenJournal, "spool": WrittenSpool}[name](directory)
    hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    refused = 0
    for number in range(1, steps + 1):
        while True:
            try:
                one.step(number)
                break
            except sqlite3.Error:
                refused += 1
                if refused == REFUSED:
                    resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
    one.close()
    print(json.dumps({"refused": refused}))


main()
