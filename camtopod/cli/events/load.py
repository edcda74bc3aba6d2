"""Load the events of a recording into memory, for programs."""

from __future__ import annotations

import os
import warnings

from camtopod.cli.events.event_lines import LineReader
from camtopod.cli.events.recording import Times, fault_of, once_by_number, recorded
from camtopod.cli.exits import DONE, CommandError
from camtopod.records import Event


def load_events(*paths: str | os.PathLike[str]) -> list[Event]:
    """Return the events of recordings, by time: event lines, CSV and what `camtopod learn` reads.

        >>> from camtopod import load_events
        >>> events = load_events("events.jsonl")
        >>> len(events), events[0].camera, events[0].kind
        (400, 'lobby', 'exit')

    Repeats count once. Lines that are no events are left out, with a `UserWarning` that counts
    them; the first of each kind is printed to standard error. Raises ValueError if a file cannot be
    read, if fewer than nine of ten lines are events, or if a spreadsheet has spoilt the times.
    """
    if not paths:
        raise ValueError("no file is named")
    reader, times = LineReader(), Times()
    lines = recorded(reader, [os.fspath(path) for path in paths], times)
    try:
        events = [line.event for line in once_by_number(reader, lines)]
    except CommandError as error:
        raise ValueError(str(error)) from None
    summary = reader.summary()
    if (fault := fault_of(times)) or not events or reader.status != DONE:
        raise ValueError(fault or summary or "there are no events")
    if summary is not None:
        warnings.warn(summary, stacklevel=2)
    return events
