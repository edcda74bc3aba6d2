"""Event lines from files and pipes: what fits becomes events, what does not is counted and quoted
once per reason.
"""

from __future__ import annotations

import heapq
import os
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from typing import BinaryIO, NamedTuple

from camtopod.adapt import LINE_BYTES_MAX, Adapter, quotable
from camtopod.cli.exits import InputError
from camtopod.codec import EVENT_BYTES_MAX, Rejected, event_from_json
from camtopod.records import Event
from camtopod.redact import redact
from camtopod.visible import visible

QUOTE_CHARACTERS_MAX = 120


class Line(NamedTuple):
    """An event and where it stands."""

    event: Event
    file: str
    number: int


class LineReader:
    """Reads lines; ``rejected`` counts by reason what did not fit, ``read`` all, ``events`` what
    came of them.
    """

    def __init__(self) -> None:
        self.rejected: Counter[str] = Counter()
        self.read = 0
        self.events = 0
        self._files: list[BinaryIO] = []

    def merged(self, paths: list[str]) -> Iterator[Line]:
        """Lines of several files in one stream by time; each file may be out of order as far as its
        lateness goes.

        ``-`` is standard input. Raises `InputError` when a file cannot be read.
        """
        with ExitStack() as stack:
            files = [(path, stack.enter_context(open_input(path))) for path in paths]
            self._files = [file for _, file in files]
            streams = [self.lines(path, file) for path, file in files]
            if len(streams) == 1:
                yield from streams[0]
            else:
                yield from heapq.merge(*streams, key=lambda line: line.event.t)

    def share(self) -> float | None:
        """How much of the files has been read, 0 to 1; None where that is not known, as of a
        pipe.
        """
        try:
            size = sum(os.fstat(file.fileno()).st_size for file in self._files if file.seekable())
            return sum(file.tell() for file in self._files) / size if size else None
        except (OSError, ValueError):  # not seekable; closed, or no file of the system
            return None

    def lines(self, path: str, file: BinaryIO) -> Iterator[Line]:
        """Events of one file in the order of its lines; blank lines are skipped."""
        for number, text in numbered(file, EVENT_BYTES_MAX):
            self.read += 1
            try:
                event = event_from_json(text)
            except Rejected as error:
                self.reject(error.reason, f"{path}:{number}: {error}", text)
                continue
            self.events += 1
            yield Line(event, path, number)

    def adapted(
        self, path: str, lines: Iterable[tuple[int, bytes]], adapter: Adapter
    ) -> Iterator[Event]:
        """Events of another program's numbered lines. Of a line that does not fit no text is
        quoted, only its form.
        """
        for number, text in lines:
            self.read += 1
            try:
                if len(text) > LINE_BYTES_MAX:
                    raise Rejected("too-long", f"more than {LINE_BYTES_MAX} bytes")
                events = adapter.receive(text)
            except Rejected as error:
                self.reject(
                    error.reason, f"{path}:{number}: {error}", quotable(text[:LINE_BYTES_MAX])
                )
                continue
            self.events += len(events)
            yield from events
        events = adapter.close()
        self.events += len(events)
        yield from events

    def reject(self, reason: str, where: str, text: bytes = b"") -> None:
        """Count a line that changes nothing; the first of each reason is quoted on standard
        error.
        """
        self.rejected[reason] += 1
        if self.rejected[reason] == 1:
            quoted = text[:QUOTE_CHARACTERS_MAX].decode("utf-8", "backslashreplace")
            message = visible(redact(f"{where}{': ' + quoted if quoted else ''}"))
            print(
                f"camtopod: {message} (further lines of this kind are only counted)",
                file=sys.stderr,
            )

    def summary(self) -> str | None:
        """One line about what was rejected; None when everything fitted."""
        if not self.rejected:
            return None
        reasons = ", ".join(f"{reason} {n}" for reason, n in sorted(self.rejected.items()))
        return f"{sum(self.rejected.values())} of {self.read} lines changed nothing: {reasons}"


def numbered(file: BinaryIO, bytes_max: int) -> Iterator[tuple[int, bytes]]:
    """The lines that are not blank, with their numbers; of a longer one its first ``bytes_max`` + 1
    bytes.
    """
    number = 0
    while raw := file.readline(bytes_max + 2):
        number += 1
        while not raw.endswith(b"\n") and len(raw) > bytes_max and (more := file.readline(1 << 16)):
            raw = raw[: bytes_max + 1] + (b"\n" if more.endswith(b"\n") else b"")
        if text := raw.strip():
            yield number, text


def open_input(path: str) -> BinaryIO:
    """A file for reading bytes; ``-`` is standard input. Raises `InputError`."""
    if path == "-":
        return sys.stdin.buffer
    try:
        return open(path, "rb")
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from None
