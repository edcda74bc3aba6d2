"""Write a journal or a spool while its files may not grow, and then when they may again.

Arguments: journal or spool, directory, most bytes of a file, steps. Prints how often a step was
refused.
"""

from __future__ import annotations

import resource
import sqlite3
import sys
from pathlib import Path

from written import FILES

REFUSED = 20
"""Refusals after which the limit is raised."""


def main() -> None:
    """Write the steps, repeating refused ones; raise the limit after `REFUSED` refusals."""
    name, directory, limit, steps = sys.argv[1:]
    one = FILES[name](Path(directory))
    hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(limit), hard))
    refused = 0
    number = 1
    while number <= int(steps):
        try:
            one.step(number)
            number += 1
        except sqlite3.Error:
            refused += 1
            if refused == REFUSED:
                resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
    one.close()
    print(refused)


main()
