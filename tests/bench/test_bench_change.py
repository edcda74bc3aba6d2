"""`bench change`: the summary of how soon changes are found."""

from __future__ import annotations

import math

from bench.change import Found, summary


def found(after: float, needed: float, known: bool = True) -> Found:
    """Return a link with ``after`` passages since the change that was right after ``needed``."""
    return Found(known, 50.0, after, needed, not math.isnan(needed))


def test_what_is_never_found_takes_for_ever() -> None:
    rows = [
        found(90, 10),
        found(90, 30),
        found(90, math.nan),
        found(90, math.nan),
        found(90, 5, known=False),
    ]
    everything, *soon = summary("close", [*rows, found(15, 12)])
    assert everything == (
        "close, 5 links of 0 passages or more since: 3 found, after a median of 30 passages (quartiles 12 to inf);"
        " 3 alarms"
    )
    assert [line.split("within ")[1] for line in soon] == [
        "20: 0.25; 2 alarms",
        "40: 0.50; 2 alarms",
        "80: 0.50; 2 alarms",
    ]
    assert (
        "after a median of inf passages"
        in summary("open", [found(90, 10), found(90, math.nan), found(90, math.nan)])[0]
    )
    assert summary("open", [found(90, 10, known=False)]) == []
