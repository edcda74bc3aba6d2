"""A SQLite file that keeps its committed transactions through kill -9 and power cuts.

The disk must honour flushes. A damaged file is set aside, never deleted, and a new one is begun.
SQLite itself notices little damage: a torn log reads as a shorter one, a flipped bit in a value as
another value. So the log is checked before SQLite opens it (`wal_check`), every row carries a
`crc`, and a grabber remembers what was acknowledged (`camtopod.serve.outbox.spool`).
"""

from __future__ import annotations

import contextlib
import fcntl
import filecmp
import functools
import logging
import os
import shutil
import sqlite3
import warnings
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec

from camtopod.serve.storage import wal_check
from camtopod.serve.storage.open_files import Identity, OpenFiles

log = logging.getLogger(__name__)

DAMAGED_FILES_MAX = 8
"""Most damaged files set aside beside one database; with more, no new one is begun."""
SCAN_BYTES_MAX = 64 * 2**20
"""Larger files are scanned on opening only if they have shown damage; this size takes about 1 s."""

_AUTOCHECKPOINT_PAGES = 200
"""Length of the write-ahead log, in pages, at which SQLite copies it into the database."""
_LOG_BYTES_MAX = 2**20
"""Size to which SQLite truncates a write-ahead log that has become larger, in bytes."""
_BUSY_SECONDS = 2.0
"""Longest wait for another connection's lock on the database, in seconds."""
_SIDE_FILES = ("-wal", "-journal")
_SHAPE = """
SELECT m.type, m.name, m.tbl_name, x.name, x.type, x."notnull", x.pk
FROM sqlite_schema AS m LEFT JOIN pragma_table_xinfo(m.name) AS x ON m.type = 'table'
WHERE m.name NOT LIKE 'sqlite_%' ORDER BY 2, 4
"""
_encode = msgspec.msgpack.Encoder().encode


class StateError(OSError):
    """The state directory cannot be written or is in use; ``str()`` says which, and what to do."""


class Damaged(StateError):
    """The content of a file differs from what was written."""


class Lock:
    """Exclusive lock on a path, until it is closed or the process ends."""

    def __init__(self, path: Path) -> None:
        try:
            _make_directory(path.parent)
            self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        except OSError as error:
            raise StateError(
                f"cannot write the state directory {path.parent}: {error.strerror}; "
                f"set [state] directory to one that can be written"
            ) from None
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._fd)
            raise StateError(
                f"{path} is held by another camtopod process; "
                f"stop that one or use another state directory"
            ) from None

        self._place = Identity(path, self._fd)

    def check(self) -> None:
        """Raise `Displaced` if the path leads to another file, which another process could lock."""
        self._place.check()

    def read(self, size: int) -> bytes:
        """Return the first ``size`` bytes of the file. Raises `OSError`."""
        return os.pread(self._fd, size, 0)

    def write(self, data: bytes) -> None:
        """Write at the beginning of the file, without syncing it. Raises `OSError`."""
        os.pwrite(self._fd, data, 0)

    def close(self) -> None:
        """Release the lock; may be called twice."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


def lock_reason(path: Path) -> str:
    """Return why the database at ``path`` cannot be opened (another process has it), or ""."""
    lock = path.with_suffix(".lock")
    if lock.exists():
        try:
            Lock(lock).close()
        except StateError as error:
            return str(error)
    return ""


def crc(*columns: int | float | str | bytes | None) -> int:
    """Return the checksum of a row, over all of its other columns."""
    return zlib.crc32(_encode(columns))


class Connection(sqlite3.Connection):
    """A connection that closes the descriptors of its files after the database, and not before.

    The reason is in `wal_check.open_index`.
    """

    def __init__(self, *given: Any, **more: Any) -> None:
        super().__init__(*given, **more)
        self._kept: list[int] = []
        self._files: OpenFiles | None = None

    def keep(self, fd: int) -> int:
        """Return ``fd``, and close it after the database."""
        self._kept.append(fd)
        return fd

    def watch(self, path: Path, index: int | None) -> None:
        """Make `check` check the files of ``path``. Raises `OSError`.

        index: the descriptor of `wal_check.open_index`, kept already, or None.
        """
        self.execute("PRAGMA page_count").fetchall()  # makes SQLite open the log
        database, log = (
            self.keep(os.open(f"{path}{suffix}", os.O_RDONLY | os.O_CLOEXEC))
            for suffix in ("", "-wal")
        )
        if index is None and (index := wal_check.open_index(path)) is not None:
            self.keep(index)
        if index is not None:
            self._files = OpenFiles(path, database, log, index)

    def check(self) -> None:
        """Raise `Displaced` if a file of the database is not in place. Not within transactions."""
        if self._files is not None:
            self._files.check()

    def close(self) -> None:
        """Close the database; may be called twice."""
        super().close()
        self._files = None
        while self._kept:
            os.close(self._kept.pop())

    def __del__(self) -> None:
        """Warn if the connection was not closed, as Python's own connections do since 3.13."""
        with contextlib.suppress(sqlite3.ProgrammingError):  # it is closed
            what = f"unclosed {self!r}, {self.total_changes} changes"
            warnings.warn(what, ResourceWarning, stacklevel=2, source=self)


def connect(
    path: Path, schema: str, prepare: Callable[[sqlite3.Connection], None] | None = None
) -> Connection:
    """Open, or create with ``schema``, a database in WAL mode under synchronous=FULL.

    prepare: called before the schema is created, in the same transaction, to migrate the file or to
        raise `StateError`.

    The file is created under synchronous=EXTRA, then switched: created under FULL, power cuts lost
    the table in half of the cases measured. Transactions are explicit (``isolation_level=None``).
    Raises `StateError` and `Damaged`.
    """
    try:
        # Look at the log before SQLite does.
        _make_private(path)
        written = wal_check.read(path)
        if (written.frames or written.headless) and path.stat().st_size == 0:
            # SQLite would delete the log.
            raise Damaged(
                f"{path} is damaged: it is empty or was missing, and its log is still there"
            )

        # Open the database, check it, and report what was lost.
        database = sqlite3.connect(
            path,
            timeout=_BUSY_SECONDS,
            isolation_level=None,
            check_same_thread=False,
            factory=Connection,
        )
        database.text_factory = _text
        with contextlib.ExitStack() as undo:
            undo.callback(database.close)
            database.execute("PRAGMA synchronous=EXTRA")
            _scan(database, path)
            if (index := wal_check.open_index(path)) is not None:
                database.keep(index)
            _report_lost(path, written, index)

            # Migrate or create the tables.
            with transaction(database):
                if prepare is not None:
                    prepare(database)
                _create(database, schema)
            _check_shape(database, schema, path)

            _switch_to_wal(database, path)
            database.watch(path, index)
            undo.pop_all()
            return database
    except sqlite3.Error as error:
        if is_damage(error, path):
            raise Damaged(f"{path} is damaged: {error}; it is left as it is") from None
        raise StateError(
            f"cannot use {path}: {error}; it is left as it is: "
            f"see whether the disk is full, or move the file away to start anew"
        ) from None
    except StateError:
        raise
    except OSError as error:
        raise StateError(f"cannot use {path}: {error.strerror}") from None


def connect_or_recreate(
    path: Path, schema: str, prepare: Callable[[sqlite3.Connection], None] | None = None
) -> tuple[Connection, Path | None]:
    """Open as `connect` does; set a damaged file aside and begin a new one.

    Returns the connection and the new path of the damaged file, if any.
    """
    try:
        return connect(path, schema, prepare), None
    except Damaged as damage:
        aside = set_aside(path)
        log.error("%s; it is now %s and a new one is begun", damage, aside)
        return connect(path, schema, prepare), aside


def move(path: Path, new: Path) -> None:
    """Move the database ``path`` to ``new``, with its write-ahead log. Raises `StateError`.

    No process may have the database open. A database at ``new`` is overwritten. The log is moved
    first, so that an interrupted move is completed by the next call.
    """
    try:
        _make_directory(new.parent)
        for suffix in (*_SIDE_FILES, ""):
            with contextlib.suppress(FileNotFoundError):
                os.rename(f"{path}{suffix}", f"{new}{suffix}")
        Path(f"{path}-shm").unlink(missing_ok=True)
        _sync_directory(new.parent)
        _sync_directory(path.parent)
    except OSError as error:
        raise StateError(f"cannot move {path} to {new}: {error.strerror}") from None


def set_aside(path: Path) -> Path:
    """Rename a damaged database and its log; return the new path.

    The log is renamed first: after a power cut in between, an old log must not be taken for the new
    file's. Raises `StateError` if there are `DAMAGED_FILES_MAX` such files already.
    """
    aside = _name_aside(path)
    try:
        for suffix in (*_SIDE_FILES, ""):
            with contextlib.suppress(FileNotFoundError):
                os.rename(f"{path}{suffix}", f"{aside}{suffix}")
                _sync_directory(path.parent)
        Path(f"{path}-shm").unlink(missing_ok=True)
    except OSError as error:
        raise StateError(f"{path} is damaged and cannot be set aside: {error.strerror}") from None
    return aside


def damaged_files(path: Path) -> list[Path]:
    """Return the files that were set aside of ``path`` and still exist, the newest last.

    Give the path of a write-ahead log for those of the log.
    """
    start = f"{path.name}.damaged-"
    names = (one.name.removeprefix(start) for one in path.parent.glob(f"{start}*"))
    return [
        path.with_name(f"{start}{number}")
        for number in sorted(int(name) for name in names if name.isdecimal())
    ]


@contextlib.contextmanager
def damage_noticed(path: Path) -> Iterator[None]:
    """Raise `Damaged` if the block finds ``path`` damaged, and have it scanned at the next start.

    It is then scanned however large it is.
    """
    try:
        yield
    except sqlite3.Error as error:
        if not is_damage(error, path):
            raise
        with contextlib.suppress(OSError):
            _suspicion(path).touch(mode=0o600)
        raise Damaged(f"{path} is damaged: {error}; it is set aside at the next start") from None


def is_damage(error: sqlite3.Error, path: Path) -> bool:
    """Return True if ``error`` means wrong content of ``path``, not a full disk or a busy file."""
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    if code == sqlite3.SQLITE_READONLY:  # SQLite's answer to a header that asks for a newer SQLite
        return os.access(path, os.W_OK) and os.access(path.parent, os.W_OK)
    return code in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)


@contextlib.contextmanager
def transaction(database: sqlite3.Connection) -> Iterator[None]:
    """Run the block in a transaction: commit it at the end, or roll it back after an error.

    A commit can raise although it is durable, so repeat only what may be stored twice.
    """
    database.execute("BEGIN IMMEDIATE")
    try:
        yield
        database.execute("COMMIT")
    finally:
        if database.in_transaction:
            database.execute("ROLLBACK")


def _name_aside(path: Path) -> Path:
    """Return the path for the next file to set aside. Raises `StateError` if there are too many."""
    before = damaged_files(path)
    if len(before) >= DAMAGED_FILES_MAX:
        raise StateError(
            f"{path} is damaged, as it was {len(before)} times before: "
            f"check the disk, and move the damaged files away"
        )
    number = int(before[-1].name.rpartition("-")[2]) + 1 if before else 1
    return path.with_name(f"{path.name}.damaged-{number}")


def _copy_aside(path: Path) -> Path:
    """Copy a damaged file, all or nothing, and return the copy's path.

    If the newest copy is equal, that one is returned: the file may be opened again before it is
    written to.
    """
    for aside in damaged_files(path)[-1:]:
        if filecmp.cmp(path, aside, shallow=False):
            return aside

    # Write and sync a copy; remove it after an error.
    aside = _name_aside(path)
    with contextlib.ExitStack() as undo, path.open("rb") as source:
        fd = os.open(aside, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
        undo.callback(aside.unlink)
        with open(fd, "wb") as target:
            shutil.copyfileobj(source, target)
            target.flush()
            os.fsync(target.fileno())
        undo.pop_all()
    _sync_directory(path.parent)
    return aside


def _make_directory(directory: Path) -> None:
    """Create a directory that only its owner can read and that survives a power cut."""
    if not directory.is_dir():
        _make_directory(directory.parent)
        directory.mkdir(mode=0o700, exist_ok=True)
        _sync_directory(directory.parent)


def _sync_directory(directory: Path) -> None:
    fd = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def _text(raw: bytes) -> str:
    """Decode a text column. A flipped bit can make it invalid UTF-8.

    The row then has a wrong CRC, and the rows beside it can still be read.
    """
    return raw.decode("utf-8", "replace")


def _make_private(path: Path) -> None:
    """Create the file if it is missing, and let only its owner read it.

    SQLite gives the log and the shared memory the mode of the file.
    """
    os.close(os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600))
    for suffix in ("", "-wal", "-shm"):
        with contextlib.suppress(FileNotFoundError):
            os.chmod(f"{path}{suffix}", 0o600)


def _create(database: sqlite3.Connection, schema: str) -> None:
    """Execute each statement of ``schema``."""
    for statement in schema.split(";"):
        database.execute(statement)


def _switch_to_wal(database: sqlite3.Connection, path: Path) -> None:
    """Switch to WAL mode under synchronous=FULL. Raises `StateError` if that is impossible."""
    database.execute("PRAGMA journal_mode=WAL")
    database.execute("PRAGMA synchronous=FULL")
    database.execute(f"PRAGMA wal_autocheckpoint={_AUTOCHECKPOINT_PAGES}")
    database.execute(f"PRAGMA journal_size_limit={_LOG_BYTES_MAX}")
    database.execute("PRAGMA mmap_size=0")
    mode = database.execute("PRAGMA journal_mode").fetchone()[0]
    synchronous = database.execute("PRAGMA synchronous").fetchone()[0]
    if (mode, synchronous) != ("wal", 2):
        raise StateError(
            f"{path}: SQLite cannot write safely on this file system ({mode}, {synchronous})"
        )


def _scan(database: sqlite3.Connection, path: Path) -> None:
    """Raise `Damaged` if pages, rows and indices disagree; scans large files on suspicion only."""
    pages = database.execute("PRAGMA page_count").fetchone()[0]
    small = pages * database.execute("PRAGMA page_size").fetchone()[0] <= SCAN_BYTES_MAX
    if small or _suspicion(path).exists():
        found = database.execute("PRAGMA integrity_check(1)").fetchone()[0]
        if found != "ok":
            raise Damaged(f"{path} is damaged: {found}; it is left as it is")
    _suspicion(path).unlink(missing_ok=True)


def _suspicion(path: Path) -> Path:
    """Return the path of the marker file that exists once ``path`` has shown damage."""
    return path.with_name(f"{path.name}.suspect")


def _report_lost(path: Path, written: wal_check.Log, index: int | None) -> None:
    """Log what SQLite has ignored of the log, and keep a copy of a damaged log."""
    lost = wal_check.lost(path, written, index)
    if lost.damaged:
        # Keep a copy of the log.
        try:
            copy = f"a copy is {_copy_aside(Path(f'{path}-wal'))}"
        except StateError:
            raise
        except OSError as error:
            # Giving up would not save the log: SQLite deletes it on closing.
            copy = f"there is no copy: {error.strerror}"
        log.error(
            "the log of %s is damaged: %s cannot be read; %s",
            path,
            "nothing of it" if lost.headless else f"{lost.transactions} transactions",
            copy,
        )
    elif lost.frames:
        # As after a kill or a power cut.
        log.warning(
            "the last transaction in the log of %s is incomplete and ignored: "
            "it was being written when the program ended, or is damaged",
            path,
        )


def _check_shape(database: sqlite3.Connection, schema: str, path: Path) -> None:
    """Raise `Damaged` if a table or an index is not as in ``schema``."""
    if not _shape_of(schema) <= set(database.execute(_SHAPE)):
        raise Damaged(
            f"{path} is damaged: its tables are not those of this program; it is left as it is"
        )


@functools.cache
def _shape_of(schema: str) -> frozenset[tuple[object, ...]]:
    """Return the tables, columns and indices that ``schema`` creates."""
    with contextlib.closing(sqlite3.connect(":memory:", isolation_level=None)) as wanted:
        _create(wanted, schema)
        return frozenset(wanted.execute(_SHAPE))


def readable(
    path: Path, table: str, key: str
) -> Iterator[tuple[int | float | str | bytes | None, ...]]:
    """Yield the rows of ``table`` that can still be read from a damaged file, some of them twice.

    They come by rising ``key`` up to the first damaged page, then from the other end. Only a row's
    CRC tells whether it is good. The file is not changed.
    """
    if path.stat().st_size == 0:
        return  # it has no rows, and SQLite would delete the log beside it
    try:
        with contextlib.closing(
            sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)
        ) as database:
            database.text_factory = _text
            for order in ("ASC", "DESC"):
                try:
                    yield from database.execute(
                        f"SELECT * FROM {table} NOT INDEXED ORDER BY {key} {order}"
                    )
                    return
                except sqlite3.Error as error:
                    log.info("reading %s of %s by %s %s: %s", table, path, key, order, error)
    except sqlite3.Error as error:
        log.info("opening %s: %s", path, error)
