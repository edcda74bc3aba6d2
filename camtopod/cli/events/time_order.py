"""Events in order of time, in bounded memory, and answers in the order of the input."""

from __future__ import annotations

import heapq
import itertools
import math
import select
import sqlite3
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from io import BufferedReader

from camtopod.cli.exits import CommandError
from camtopod.codec import event_from_msgpack, to_msgpack
from camtopod.records import Event, Kind

LINES_HELD_MAX = 10_000
"""Most lines that wait for lines with an earlier time, or whose answers wait for another answer."""
LATE_LINES_MAX = 20
"""Most late lines in a row; then the newest line had a wrong time, or another recording begins."""
SORTING_BYTES_MAX = 4 << 20
"""Size of the SQLite cache of each sort, in bytes. Larger sorts use a temporary file."""
SILENT_SECONDS = 2.0
"""Time without anything new in a pipe after which nothing earlier is waited for."""


class OrderedAnswers:
    """Answers events in order of time; returns the answers in the order of the events' arrival.

    answer: is given all events of one moment, and returns a text for each; of ``kind``, its answer.
    lateness (seconds): an event is answered when one as much later, and of another moment, has
        come. One that comes later than that is answered at once, and changes no earlier answer.
    """

    def __init__(
        self, answer: Callable[[list[Event]], list[bytes]], kind: Kind, lateness: float
    ) -> None:
        self._answer = answer
        self._kind = kind
        self._lateness = lateness
        self._newest = -math.inf
        self.late = 0
        """Number of events that came late."""
        self._late_in_a_row = 0
        self._numbers = itertools.count()
        self._heap: list[tuple[float, int, Event]] = []
        """Events that wait for earlier ones: a heap by time, then by number."""
        self._open_numbers: deque[int] = deque()
        """Numbers of the events of ``kind`` whose answers have not been returned, in order."""
        self._answers: dict[int, bytes] = {}
        """Answers that have not been returned, by number."""

    def of(self, events: Iterable[Event]) -> Iterator[bytes]:
        """Yield the answers to events as soon as they are possible."""
        for event in events:
            yield from self.add(event)
        yield from self.rest()

    def of_unordered(self, events: Iterable[Event]) -> Iterator[bytes]:
        """Yield the answers to events in any order. Raises `CommandError` if the disk is full."""

        def numbered() -> Iterator[tuple[int, bytes]]:
            """Yield the answers in order of time, each with the number of its event."""
            numbers: deque[int] = deque()
            for number, record in by_key((event.t, to_msgpack(event)) for event in events):
                event = event_from_msgpack(record)
                if event.kind == self._kind:
                    numbers.append(number)
                yield from ((numbers.popleft(), text) for text in self.add(event))
            yield from zip(numbers, self.rest(), strict=True)

        with sorting():
            yield from (text for _, text in by_key(numbered()))

    def add(self, event: Event) -> list[bytes]:
        """Add an event; return the answers that this makes possible."""
        number = next(self._numbers)
        heapq.heappush(self._heap, (event.t, number, event))
        if event.kind == self._kind:
            self._open_numbers.append(number)
        self._newest = max(self._newest, event.t)
        before = math.nextafter(self._newest, -math.inf)
        answer_until = min(self._newest - self._lateness, before)
        is_late = event.t <= answer_until
        self.late += is_late
        self._late_in_a_row = self._late_in_a_row + 1 if is_late else 0
        held_count = max(len(self._heap), len(self._open_numbers))
        if held_count >= LINES_HELD_MAX or self._late_in_a_row >= LATE_LINES_MAX:
            return self.rest()
        return self._until(answer_until)

    def rest(self) -> list[bytes]:
        """Return all remaining answers, without waiting for earlier events."""
        self._newest, self._late_in_a_row = -math.inf, 0
        return self._until(math.inf)

    def _until(self, t: float) -> list[bytes]:
        """Answer the events up to a time, and return the answers whose turn it is."""
        heap = self._heap
        while heap and heap[0][0] <= t:
            moment = [heapq.heappop(heap)]
            while heap and heap[0][0] == moment[0][0]:
                moment.append(heapq.heappop(heap))
            answers = self._answer([event for _, _, event in moment])
            for (_, number, event), answer in zip(moment, answers, strict=True):
                if event.kind == self._kind:
                    self._answers[number] = answer

        turn = []
        while self._open_numbers and self._open_numbers[0] in self._answers:
            turn.append(self._answers.pop(self._open_numbers.popleft()))
        return turn


class Pipe:
    """A pipe, whose reader does something else before it waits.

    pause: called when nothing has come.
    silent: called when nothing has come for `SILENT_SECONDS`, before ``pause``.
    """

    def __init__(
        self, file: BufferedReader, pause: Callable[[], None], silent: Callable[[], None]
    ) -> None:
        self._file = file
        self._pause = pause
        self._silent = silent

    def read1(self, size: int) -> bytes:
        """Read at most ``size`` bytes; block while the pipe is empty."""
        if not self._ready(0.0):
            self._pause()
            if not self._ready(SILENT_SECONDS):
                self._silent()
                self._pause()
        return self._file.read1(size)

    def _ready(self, seconds: float) -> bool:
        """Return True if something comes within ``seconds``."""
        return bool(select.select([self._file], [], [], seconds)[0])


@contextmanager
def sorting() -> Iterator[None]:
    """Raise `CommandError` with what to do if a sort fails."""
    try:
        yield
    except sqlite3.Error as error:
        raise sorting_failure(error) from None


def sorting_failure(error: Exception) -> CommandError:
    """Return the error of a temporary file."""
    return CommandError(
        "lines that are not in order of time are sorted in a temporary file, which failed "
        f"({error}): make room, set TMPDIR to another directory, or sort the lines by t"
    )


def by_key(records: Iterable[tuple[float, bytes]]) -> Iterator[tuple[int, bytes]]:
    """Sort records, each a key and a content; yield their numbers (from 1) and contents.

    Those with the same key stay in order. Raises `sqlite3.Error`, as when the disk is full.
    """
    with closing(sqlite3.connect("")) as base:  # a temporary file, which has no name
        base.execute(f"PRAGMA cache_size = {-SORTING_BYTES_MAX // 1024}")
        base.execute("PRAGMA journal_mode = OFF")
        base.execute("CREATE TABLE record (number INTEGER PRIMARY KEY, key REAL, content BLOB)")
        base.executemany("INSERT INTO record (key, content) VALUES (?, ?)", records)
        yield from base.execute("SELECT number, content FROM record ORDER BY key, number")
