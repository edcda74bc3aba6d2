"""Compare events that arrive under a number (seq) that is already stored.

Nearly always it is the same event again. A different event means that a publisher has gone back in
time (as a virtual machine set back while it ran), or that two publishers share their numbers; then
an event is not stored, and that is reported.
"""

from __future__ import annotations

import collections
import logging
import threading
from collections.abc import Mapping

from msgspec.structs import replace

from camtopod import codec
from camtopod.records import Event
from camtopod.serve.ingest.sequencing import Key
from camtopod.serve.runtime import Clock
from camtopod.serve.storage import Entry, Journal

log = logging.getLogger(__name__)

WAITING_MAX = 50_000
"""Most duplicates that wait to be compared; a further one is compared when it comes again."""
COMPARED_MAX = 2_000
"""Most duplicates compared in one call."""
SAID_SECONDS = 600.0
"""How long the status mentions a contradiction."""
NAMED_MAX = 1_000
"""Most streams that are named in the log, each once."""


class DuplicateChecker:
    """Compares duplicates with the journal; `note` is called in one thread, `compare` in another.

    steady: a clock that never steps.
    """

    def __init__(self, journal: Journal, steady: Clock) -> None:
        self._journal, self._steady = journal, steady
        self._waiting: collections.deque[Entry] = collections.deque()
        self._named: set[Key] = set()
        self._last: tuple[float, str] | None = None
        self._mutex = threading.Lock()
        self.contradicted = 0
        """Number of events whose number another event has; they are not stored."""

    def note(self, entry: Entry) -> None:
        """Note an event whose number is already used by one that is stored, or about to be."""
        if len(self._waiting) < WAITING_MAX:
            self._waiting.append(entry)

    def compare(self, stored: Mapping[Key, int]) -> None:
        """Compare some of the events noted. Raises `sqlite3.Error`.

        stored: the highest stored seq of each stream; events above it wait.
        """
        for _ in range(min(len(self._waiting), COMPARED_MAX)):
            entry = self._waiting.popleft()
            assert entry.boot is not None
            assert entry.seq is not None
            if entry.seq > stored.get((entry.camera, entry.boot), -1):
                self._waiting.append(entry)
                continue
            before = self._journal.find_entry(entry.camera, entry.boot, entry.seq)
            if before is not None and before.kind != "refused" and not _same(before.raw, entry.raw):
                self._say(entry)

    @property
    def reason(self) -> str:
        """What was found recently; "" if nothing was. Any thread."""
        with self._mutex:
            if self._last is None or self._steady() - self._last[0] > SAID_SECONDS:
                return ""
            return self._last[1]

    def _say(self, entry: Entry) -> None:
        self.contradicted += 1
        what = (
            f"camera {entry.camera} has sent two different events under one number (boot"
            f" {entry.boot}, seq {entry.seq}), and the second is not stored: its publisher has gone"
            " back in time, or two publishers share one spool; restart the publisher, and it begins"
            " a new count"
        )
        key = (entry.camera, entry.boot or "")
        with self._mutex:
            self._last = self._steady(), what
        if key not in self._named and len(self._named) < NAMED_MAX:
            self._named.add(key)
            log.error("%s", what)


def _same(one: bytes, other: bytes) -> bool:
    """Return True if two messages are the same event, perhaps in different encodings.

    The camera, which is that of the stream, may have been renamed in one of them.
    """
    return one == other or _read(one) == _read(other) is not None


def _read(raw: bytes) -> Event | None:
    try:
        return replace(codec.event_from_bytes(raw), camera="")
    except codec.Rejected:
        return None
