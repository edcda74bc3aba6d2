"""Reader of event lines from files and pipes.

Valid lines become events; others are counted, and the first one of each mistake is quoted.
"""

from __future__ import annotations

import itertools
import logging
import os
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from io import BufferedReader
from typing import Any, NamedTuple, TypeVar

from camtopod.adapt import LINE_BYTES_MAX, Adapter, frames
from camtopod.cli import exits
from camtopod.cli.events import csv_rows, table_files
from camtopod.cli.events.file_forms import PIECE_BYTES, Readable, pieces
from camtopod.cli.events.table_rows import COLUMNS
from camtopod.cli.exits import InputError
from camtopod.codec import EVENT_BYTES_MAX, Rejected, event_from_json, read, to_json
from camtopod.records import Event
from camtopod.redact import redact
from camtopod.visible import visible

RowT = TypeVar("RowT")

log = logging.getLogger(__name__)

ACCEPTED_MIN = 0.9
"""Least share of accepted lines with which a command succeeds."""


class Line(NamedTuple):
    """An event with its file and line number, and its place (from 0) among the file's messages."""

    event: Event
    file: str
    number: int
    place: int


class LineReader:
    """Reads lines and counts them.

    ``lines_read`` counts all lines, ``events`` the resulting events, ``rejections`` the other lines
    by mistake: a reason and, if there is one, the field. ``repeats`` are lines with an event that
    another line has, too: they are no mistake.
    """

    def __init__(self) -> None:
        self.rejections: Counter[str] = Counter()
        self.repeats = 0
        self.labels_dropped = 0
        """Events whose label is not valid; they count without it."""
        self.boxes_share = 1.0
        """Share of the boxes of another program's tracks that could be used."""
        self.lines_read = 0
        self.events = 0
        self.files: list[BufferedReader] = []
        """The files, for `share`."""

    def share(self) -> float | None:
        """Return the share of the files that has been read, 0 to 1; None if unknown (a pipe)."""
        try:
            size = sum(os.fstat(file.fileno()).st_size for file in self.files if file.seekable())
            return sum(file.tell() for file in self.files) / size if size else None
        except (OSError, ValueError):  # not seekable; closed, or no file of the system
            return None

    def lines(self, path: str, file: Readable) -> Iterator[Line]:
        """Yield the events of a file, lines of JSON or a table, in order; blank lines are skipped.

        Raises `InputError` for a table without the columns it needs.
        """
        number = 0

        def drop_label(error: Rejected) -> None:
            self._drop_label(f"{path}:{number}", error)

        for place, (number, text) in enumerate(messages(path, file)):
            self.lines_read += 1
            try:
                if isinstance(text, Rejected):
                    raise text
                event = event_from_json(text, drop_label)
            except Rejected as error:
                quote = text if isinstance(text, bytes) else b""
                self.reject(error.reason, f"{path}:{number}: {error}", quote)
                continue
            self.events += 1
            yield Line(event, path, number, place)

    def adapted(
        self, path: str, lines: Iterable[tuple[int, bytes]], adapter: Adapter, live: bool = False
    ) -> Iterator[Event]:
        """Yield events from another program's numbered lines.

        live: the lines come as things happen. Empty lines are then occasions to ask the adapter for
            the events of cameras that are silent.

        Of a rejected line nothing is quoted, as it may name people. Whatever an adapter raises, it
        is this line that is rejected.
        """
        adapter.say = lambda note: log.warning("%s: %s", path, note)
        for number, text in lines:
            events = []
            if live:
                events = adapter.silent(time.monotonic())
            if text:
                self.lines_read += 1
                try:
                    if len(text) > LINE_BYTES_MAX:
                        raise Rejected("too-long", f"more than {LINE_BYTES_MAX} bytes")
                    drop = partial(self._drop_label, f"{path}:{number}")
                    events += [
                        event_from_json(to_json(event), drop) for event in adapter.receive(text)
                    ]
                except Rejected as error:
                    self.reject(error.reason, f"{path}:{number}: {error}")
                except Exception as error:  # no message of another program may end the reading
                    log.debug("%s:%d", path, number, exc_info=True)
                    fault = f"it cannot be read ({type(error).__name__})"
                    self.reject("unreadable", f"{path}:{number}: {fault}")
            self.events += len(events)
            yield from events
        events = adapter.close()
        boxes = adapter.boxes_used + adapter.boxes_unused
        self.boxes_share = adapter.boxes_used / boxes if boxes else 1.0
        self.events += len(events)
        yield from events

    def reject(self, reason: str, position: str, text: bytes = b"") -> None:
        """Count a rejected line; print the first one of each reason and place in a message."""
        place = position.partition(" - at ")[2]
        mistake = " ".join(filter(None, [reason, place.strip("`$.")]))
        self.rejections[mistake] += 1
        if self.rejections[mistake] == 1:
            quote = text[:120].decode("utf-8", "backslashreplace")
            say(redact(": ".join(filter(None, [position, quote]))))

    def reject_event(self, reason: str, position: str) -> None:
        """Reject a line that has been yielded as an event; ``position`` as for `reject`."""
        self.events -= 1
        self.reject(reason, position)

    def repeat(self, line: Line) -> None:
        """Count a line whose event has come before; print the first one."""
        self.events -= 1
        self.repeats += 1
        if self.repeats == 1:
            say(f"{line.file}:{line.number}: repeats an event, which counts once")

    def _drop_label(self, position: str, error: Rejected) -> None:
        """Count an invalid label; print the first one's mistake in a message."""
        self.labels_dropped += 1
        if self.labels_dropped == 1:
            say(f"{position}: {error}; the event counts without its label")

    @property
    def accepted(self) -> int:
        """Number of lines that were accepted, repeats included."""
        return self.lines_read - self.rejections.total()

    @property
    def status(self) -> int:
        """Exit status of the command: `exits.FAILED` if too few lines, or boxes, were accepted;
        `exits.INPUT` if no box was.

        Neither repeats nor messages of other topics count.
        """
        used = self.accepted - self.repeats
        rejected = self.rejections.total() - self.rejections["other-topic"]
        lacks_lines = used < ACCEPTED_MIN * (used + rejected)
        if not self.boxes_share:
            return exits.INPUT
        lacks_boxes = self.boxes_share < ACCEPTED_MIN
        return exits.FAILED if lacks_lines or lacks_boxes else exits.DONE

    def summary(self) -> str | None:
        """Return one line about the lines that were used; None if all of them were, in full."""
        parts = []
        if self.rejections:
            mistakes = ", ".join(f"{mistake} {n}" for mistake, n in sorted(self.rejections.items()))
            total = self.rejections.total()
            parts.append(f"{self.accepted} of {self.lines_read} lines were accepted")
            parts.append(f"{total} of {self.lines_read} lines were rejected: {mistakes}")
        if self.repeats:
            parts.append(f"{self.repeats} of {self.lines_read} lines are repeats, counted once")
        if self.labels_dropped:
            parts.append(f"{self.labels_dropped} labels were not valid, their events count")
        return "; ".join(parts) or None


def say(message: str) -> None:
    """Print the first message of its kind to standard error."""
    print(f"camtopod: {visible(message)} (further ones are only counted)", file=sys.stderr)


def table_rows_of(
    path: str, columns: tuple[str, ...], kind: type[RowT]
) -> Iterator[tuple[int, RowT]]:
    """Yield each row of a table of other things than events, with its number.

    columns: those that it needs. kind: the struct of a row.

    Raises `InputError` for the first row that is none.
    """
    with open_input(path) as file:
        for number, line in messages(path, file, columns):
            try:
                row = line if isinstance(line, Rejected) else read(kind, line)
            except Rejected as error:
                row = error
            if isinstance(row, Rejected):
                raise InputError(f"{path}:{number}: {row}")
            yield number, row


def messages(
    path: str, file: Readable, needed: Sequence[str] = COLUMNS
) -> Iterator[tuple[int, bytes | Rejected]]:
    """Yield each line of a file that should be an event, as JSON, with its number (from 1).

    needed: columns that a table must have.

    Of a row without sense it is the mistake. Raises `InputError` for a table without the columns it
    needs, and for a file that is neither text nor a table.
    """
    beginning = file.read1(PIECE_BYTES)
    if (form := table_files.form_of(beginning)) is not None:
        return table_files.rows(path, _rewound(path, file, len(beginning), form), form, needed)
    later_pieces = pieces(path, file, beginning)
    first_pieces: list[bytes] = []
    for piece in later_pieces:
        first_pieces.append(piece)
        if csv_rows.is_told(b"".join(first_pieces)):
            break
    whole = itertools.chain(first_pieces, later_pieces)
    if (header := csv_rows.header_of(b"".join(first_pieces), needed)) is not None:
        return csv_rows.rows(whole, path, header, needed)
    return frames(whole, EVENT_BYTES_MAX)


def _rewound(path: str, file: Any, size: int, form: str) -> BufferedReader:
    """Return a file whose first bytes were read, from its beginning. Raises `InputError`."""
    try:
        file.seek(-size, os.SEEK_CUR)
    except (OSError, AttributeError):
        raise InputError(f"{path} is {form}, which is read from a file only") from None
    return file  # type: ignore[no-any-return]


def open_input(path: str) -> BufferedReader:
    """Open a file for reading bytes; ``-`` is standard input. Raises `InputError`."""
    if path == "-":
        return sys.stdin.buffer  # type: ignore[return-value]
    try:
        return open(path, "rb")
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from None
