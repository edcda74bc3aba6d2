"""The check that open files are still the ones at their paths, unchanged by other programs.

A process can go on writing to a file that was removed, moved or replaced, and SQLite to one that
was cut off. Neither reports an error, and after a restart the transactions are not there. So each
transaction is preceded and followed by this check, which takes some microseconds.
"""

from __future__ import annotations

import os
import sqlite3
from pathlib import Path

from camtopod.serve.storage import wal_check

_HEAD_BYTES = 100
"""The header of a database: it counts the changes of the file, and its free pages."""
_MOVE_BACK = "move the file back, or restart the program, which goes on with the files it finds"
_RESTART = "restart the program, which goes on with what can be read of it"


class Displaced(sqlite3.OperationalError):
    """An open file is not the one at its path, or another program changed it; ``str()`` says which,
    and what to do.
    """


class Identity:
    """The file that a descriptor is open on, and its path."""

    def __init__(self, path: str | Path, fd: int) -> None:
        self.path = path
        opened = os.fstat(fd)
        self._file = opened.st_dev, opened.st_ino

    def check(self) -> int:
        """Return the size in bytes of the file at the path. Raises `Displaced` unless it is this
        one.
        """
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
    """A database in WAL mode, its log and the index of the log, as descriptors that are open for
    reading.

    The database is at ``path``. It is used between transactions only, and the descriptors are
    closed after SQLite has closed the database.
    """

    def __init__(self, path: Path, database: int, log: int, index: int) -> None:
        self._path, self._database, self._log, self._index = path, database, log, index
        self._places = Identity(path, database), Identity(f"{path}-wal", log)
        self._bytes = os.fstat(database).st_size
        self._head, self._indexed = self._read()

    def check(self) -> None:
        """Raise `Displaced` if one of the files is not the one that is open, or was changed by
        another program.
        """
        size, log_size = (place.check() for place in self._places)
        try:
            head, indexed = self._read()
            log_is_whole = wal_check.is_whole(self._log, log_size, indexed)
        except OSError as error:
            raise Displaced(f"{self._path} cannot be read any more: {error.strerror}") from None

        if size < self._bytes:
            raise Displaced(f"{self._path} was cut to {size} bytes while it is in use: {_RESTART}")
        if head != self._head and indexed == self._indexed:  # no checkpoint since
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
