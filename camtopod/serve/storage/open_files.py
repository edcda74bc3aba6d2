"""Check that open files are still the ones at their paths, and unchanged by other programs.

A process can go on writing to a file that was removed, moved or replaced, and SQLite to one that
was truncated. Neither reports an error, and after a restart the transactions are missing. So this
check precedes and follows each transaction; it takes some microseconds.
"""

from __future__ import annotations

import os
import sqlite3
from pathlib import Path

from camtopod.serve.storage import wal_check

_HEAD_BYTES = 100
"""Size of a database's header, which counts the changes of the file and its free pages."""
_MOVE_BACK = "move the file back, or restart the program, which goes on with the files it finds"
_RESTART = "restart the program, which goes on with what can be read of it"


class Displaced(sqlite3.OperationalError):
    """An open file is not the one at its path, or another program has changed it.

    ``str()`` says which file, and what to do.
    """


class Identity:
    """A path, and the identity (device, inode) of the file that was opened there."""

    def __init__(self, path: str | Path, fd: int) -> None:
        self.path = path
        opened = os.fstat(fd)
        self._file = opened.st_dev, opened.st_ino

    def check(self) -> int:
        """Return the size in bytes of the file at the path; raise `Displaced` if it is another."""
        try:
            found = os.stat(self.path)
        except OSError as error:
            raise Displaced(
                f"{self.path} is gone while it is in use ({error.strerror}): {_MOVE_BACK}"
            ) from None
        if (found.st_dev, found.st_ino) != self._file:
            raise Displaced(
                f"{self.path} was replaced by another file while it is in use: {_MOVE_BACK}"
            )
        return found.st_size


class OpenFiles:
    """Descriptors of a database in WAL mode, of its log and of the log's index, open for reading.

    The database is at ``path``. Use this between transactions only, and close the descriptors after
    SQLite has closed the database.
    """

    def __init__(self, path: Path, database: int, log: int, index: int) -> None:
        self._path, self._database, self._log, self._index = path, database, log, index
        self._places = Identity(path, database), Identity(f"{path}-wal", log)
        self._bytes = os.fstat(database).st_size
        self._head, self._indexed = self._read()

    def check(self) -> None:
        """Raise `Displaced` if a file is not the open one, or was changed by another program."""

        # Is the same file at each path?
        size, log_size = (place.check() for place in self._places)

        # Read the headers.
        try:
            head, indexed = self._read()
            log_is_whole = wal_check.is_whole(self._log, log_size, indexed)
        except OSError as error:
            raise Displaced(f"{self._path} cannot be read any more: {error.strerror}") from None

        # Was a file truncated or overwritten?
        if size < self._bytes:
            raise Displaced(f"{self._path} was cut to {size} bytes while it is in use: {_RESTART}")
        if head != self._head and indexed == self._indexed:  # without a checkpoint
            raise Displaced(f"{self._path} was overwritten while it is in use: {_RESTART}")
        if not log_is_whole:
            raise Displaced(
                f"{self._path}-wal was cut or overwritten while it is in use: {_RESTART}"
            )

        self._bytes, self._head, self._indexed = size, head, indexed

    def _read(self) -> tuple[bytes, bytes]:
        return os.pread(self._database, _HEAD_BYTES, 0), os.pread(
            self._index, wal_check.INDEX_BYTES, 0
        )
