"""A record of the journal's newest row numbers beside it, which shows that a journal was set back.

The line is written after each transaction and never synced, so it is never ahead of the journal.
After a power cut it may be older. It ends with a checksum: a damaged one shows nothing.
"""

from __future__ import annotations

import contextlib
from typing import NamedTuple

import msgspec

from camtopod.serve.storage.sqlite_file import Lock, crc


class JournalExtent(NamedTuple):
    """How far a journal has come.

    entries, versions: the numbers of the newest ones.
    epoch: the newest epoch that has begun.
    """

    entries: int = 0
    versions: int = 0
    epoch: str = ""


class Witness:
    """The record, one line in the journal's lock file, which only the holder of the lock writes."""

    def __init__(self, lock: Lock) -> None:
        self._lock = lock
        self.extent = JournalExtent()
        """The record as it was read or written last; the default if it could not be read."""
        with contextlib.suppress(OSError):
            line = lock.read(1000).partition(b"\n")[0]
            content, _, checksum = line.rpartition(b" ")
            if checksum == b"%d" % crc(content):
                self.extent = msgspec.json.decode(content, type=JournalExtent)

    def note(self, extent: JournalExtent) -> None:
        """Write how far the journal has come. Errors are ignored."""
        self.extent = extent
        with contextlib.suppress(OSError):
            content = msgspec.json.encode(extent)
            self._lock.write(b"%b %d\n" % (content, crc(content)))
