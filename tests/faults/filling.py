"""A program that writes a journal or a spool while its files may not grow, and then when they may
again.

Arguments: journal or spool, directory, bytes a file may have, steps. Says on standard output how
often it was refused.
"""

from __future__ import annotations

import json
import resource
import sqlite3
import sys
from pathlib import Path

from written import WrittenJournal, WrittenSpool

REFUSED = 20


def main() -> None:
    """Be refused ``REFUSED`` times, then have the limit raised."""
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
