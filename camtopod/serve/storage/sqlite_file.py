"""A SQLite file that keeps its committed transactions through kill -9 and power cuts.

The disk must honour flushes. SQLite's own check runs when a file is opened, and every row carries a
`crc` of its other columns, as SQLite does not notice a flipped bit in a value. A damaged file is
set aside, never deleted, and a new one is begun with the rows that can be read of the old one.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import logging
import os
import shutil
import sqlite3
import weakref
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec

log = logging.getLogger(__name__)

DAMAGED_FILES_MAX = 8
"""Maximum number of damaged files set aside beside one database; with more, no new one is begun."""
THOROUGH_BYTES_MAX = 64 * 2**20
"""Size, in bytes, up to which indices are compared with their tables on opening; this takes 1 s."""

SHARED_BYTES = 32 * 2**10
"""Size, in bytes, of the smallest file by which SQLite shares memory between programs."""

_SHAPE = """
SELECT m.type, m.name, m.tbl_name, x.name, x.type, x."notnull", x.pk
FROM sqlite_schema AS m LEFT JOIN pragma_table_xinfo(m.name) AS x ON m.type = 'table'
WHERE m.name NOT LIKE 'sqlite_%' ORDER BY 2, 4
"""
_encode = msgspec.msgpack.Encoder().encode
_text = functools.partial(str, encoding="utf-8", errors="replace")
"""Decodes a text column. A flipped bit can make it invalid UTF-8: the row then has a wrong CRC, and
the rows beside it can still be read.
"""


class StateError(OSError):
    """The state directory cannot be written or is in use; ``str()`` says which, and what to do."""


class InUse(StateError):
    """Another process has the lock."""


class Damaged(StateError):
    """The content of a file is not that which was written."""


class Displaced(sqlite3.OperationalError):
    """The open file is no longer the one at its path; ``str()`` says what to do."""


class Lock:
    """Exclusive lock on a path, until it is closed or the process ends; children do not keep it.

    A forked child shares the lock for as long as it has the descriptor. So the parent releases the
    lock for all who share it, and a child only leaves it (`leave`).
    """

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
        except OSError as error:
            os.close(self._fd)
            if isinstance(error, BlockingIOError):
                raise InUse(
                    f"{path} is held by another camtopod process; "
                    "stop that one or use another state directory"
                ) from None
            reason = f"cannot be locked: {error.strerror}: {_needs_local_disk(path)}"
            raise StateError(f"{path} {reason}") from None
        _locks.add(self)

    def read(self, size: int) -> bytes:
        """Return the first ``size`` bytes of the file. Raises `OSError`."""
        return os.pread(self._fd, size, 0)

    def write(self, data: bytes) -> None:
        """Write at the beginning of the file, without syncing it. Raises `OSError`."""
        os.pwrite(self._fd, data, 0)

    def close(self) -> None:
        """Release the lock; may be called twice."""
        if self._fd >= 0:
            fcntl.flock(self._fd, fcntl.LOCK_UN)
        self.leave()

    def leave(self) -> None:
        """Close the descriptor: in a forked child, this leaves the lock to the parent."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


_locks: weakref.WeakSet[Lock] = weakref.WeakSet()


def _release() -> None:
    """Leave the parent's locks to the parent, in a forked child."""
    for lock in list(_locks):
        lock.leave()


os.register_at_fork(after_in_child=_release)


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


def sound(row: Sequence[Any]) -> bool:
    """Return True if a row has the right checksum: its values, and their types, are as written."""
    return bool(crc(*row[:-1]) == row[-1])


class Connection(sqlite3.Connection):
    """A connection that knows which file it has opened."""

    def __init__(self, path: Path, *arguments: Any, **options: Any) -> None:
        super().__init__(path, *arguments, **options)
        self._path = path
        self._inode = os.stat(path).st_ino

    def check(self) -> None:
        """Raise `Displaced` if the file was removed, moved or replaced since it was opened.

        SQLite would continue to write to a deleted file.
        """
        try:
            is_same = os.stat(self._path).st_ino == self._inode
        except OSError:
            is_same = False
        if not is_same:
            raise Displaced(
                f"{self._path} was removed or replaced while it is in use: "
                "move it back, or restart the program, which goes on with the file it finds"
            )


def connect(
    path: Path, schema: str, format_number: int, needed_tables: tuple[str, ...] = ()
) -> Connection:
    """Open, or create with ``schema``, a database in WAL mode that syncs each transaction.

    format_number: kept in the table ``meta`` (key, value, crc), which ``schema`` has to create;
        a file of another format is refused.
    needed_tables: those of which every row must be undamaged.

    Transactions are explicit (``isolation_level=None``). Raises `StateError` and `Damaged`.
    """
    try:
        _make_private(path)
        try:
            return _open(path, schema, format_number, needed_tables, "NORMAL")
        except sqlite3.OperationalError as error:
            # On a full disk there is no room for the memory that is shared with other programs.
            if not _is_io(error) or shutil.disk_usage(path.parent).free >= SHARED_BYTES:
                raise
            log.warning("%s is on a full disk: no other program can read it meanwhile", path)
            return _open(path, schema, format_number, needed_tables, "EXCLUSIVE")
    except sqlite3.Error as error:
        remedy = "see whether the disk is full, or move the file away to start anew"
        if _is_io(error):
            remedy = _needs_local_disk(path)
        raise StateError(
            f"cannot use {path}: {error}; the file was not modified: {remedy}"
        ) from None
    except StateError:
        raise
    except OSError as error:
        raise StateError(f"cannot use {path}: {error.strerror}") from None


def _open(path: Path, schema: str, number: int, tables: Sequence[str], locks: str) -> Connection:
    """Do what `connect` does; with ``locks`` EXCLUSIVE without memory shared through a file."""
    database = sqlite3.connect(
        path, timeout=2.0, isolation_level=None, check_same_thread=False, factory=Connection
    )
    with contextlib.ExitStack() as undo, damage_noticed(path):
        undo.callback(database.close)
        database.text_factory = _text
        database.execute(f"PRAGMA locking_mode={locks}")

        # Under FULL, power cuts lost newly created tables in half of the cases measured.
        database.execute("PRAGMA synchronous=EXTRA")
        check = "integrity_check" if path.stat().st_size <= THOROUGH_BYTES_MAX else "quick_check"
        report = database.execute(f"PRAGMA {check}(1)").fetchone()[0]
        if report != "ok":
            raise Damaged(f"{path} is damaged: {' '.join(report.split())}")

        # Create or check the tables.
        with transaction(database):
            if not database.execute("SELECT 1 FROM sqlite_schema").fetchone():
                _create(database, schema)
                row = "format", str(number)
                database.execute("INSERT INTO meta VALUES (?, ?, ?)", (*row, crc(*row)))
            format_row = database.execute("SELECT * FROM meta WHERE key = 'format'").fetchone()
            if format_row is None or (
                len(format_row) > 2 and format_row[2] != crc(*format_row[:2])
            ):
                raise Damaged(f"{path} is damaged: it does not say its format")
            if format_row[1] != str(number):
                raise StateError(
                    f"{path} has format {format_row[1]} and this version of camtopod writes"
                    f" {number}: move the state directory away to start anew, or use the version"
                    " that wrote it"
                )
        if not _shape_of(schema) <= set(database.execute(_SHAPE)):
            raise Damaged(f"{path} is damaged: its tables are not those of this program")
        for table in tables:
            if not all(map(sound, database.execute(f"SELECT * FROM {table}"))):
                raise Damaged(f"{path} is damaged: a row of its table {table}")

        # Switch to WAL mode.
        mode = database.execute("PRAGMA journal_mode=WAL").fetchone()[0]
        if mode != "wal":
            raise StateError(
                f"{path}: SQLite cannot write safely here ({mode}): {_needs_local_disk(path)}"
            )
        database.execute("PRAGMA wal_autocheckpoint=200")  # pages in the log
        database.execute("PRAGMA journal_size_limit=1048576")  # bytes that a longer log is cut to
        database.execute("PRAGMA mmap_size=0")
        undo.pop_all()
        return database


def _is_io(error: sqlite3.Error) -> bool:
    """Return True if the file system has failed."""
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    return code in (sqlite3.SQLITE_IOERR, sqlite3.SQLITE_CANTOPEN)


def _needs_local_disk(path: Path) -> str:
    """Return what a path needs, and the type of its file system, as "ext4" or "fuse.mergerfs"."""
    best = (Path(), "unknown")
    with contextlib.suppress(OSError):
        for line in Path("/proc/mounts").read_text("utf-8", "replace").splitlines():
            mount, kind = line.split(" ")[1:3]
            place = Path(mount.replace("\\040", " "))
            if path.resolve().is_relative_to(place) and place >= best[0]:
                best = (place, kind)
    return (
        "the state needs a local disk that has room and is in order, and this is a file system of"
        f" type {best[1]}"
    )


def connect_or_recreate(
    path: Path, schema: str, format_number: int, needed_tables: tuple[str, ...] = ()
) -> tuple[Connection, Path | None]:
    """Open as `connect` does; set a damaged file aside and begin a new one.

    Returns the connection and the new path of the damaged file, if any.
    """
    try:
        return connect(path, schema, format_number, needed_tables), None
    except Damaged as damage:
        aside = set_aside(path)
        log.error("%s; it is now %s and a new one is begun", damage, aside)
        return connect(path, schema, format_number, needed_tables), aside


def set_aside(path: Path) -> Path:
    """Rename a damaged database and its log; return the new path.

    The log is renamed first: after a power cut in between, an old log must not be taken for the new
    file's. Raises `StateError` if there are `DAMAGED_FILES_MAX` such files already.
    """
    before = damaged_files(path)
    if len(before) >= DAMAGED_FILES_MAX:
        raise StateError(
            f"{path} is damaged, as it was {len(before)} times before: "
            f"check the disk, and move the damaged files away"
        )
    number = int(before[-1].name.rpartition("-")[2]) + 1 if before else 1
    aside = path.with_name(f"{path.name}.damaged-{number}")
    try:
        for suffix in ("-wal", "-journal", ""):
            with contextlib.suppress(FileNotFoundError):
                os.rename(f"{path}{suffix}", f"{aside}{suffix}")
                _sync_directory(path.parent)
        Path(f"{path}-shm").unlink(missing_ok=True)
    except OSError as error:
        raise StateError(f"{path} is damaged and cannot be set aside: {error.strerror}") from None
    return aside


def damaged_files(path: Path) -> list[Path]:
    """Return the files that were set aside of ``path`` and still exist, the newest last."""
    start = f"{path.name}.damaged-"
    names = (file.name.removeprefix(start) for file in path.parent.glob(f"{start}*"))
    return [
        path.with_name(f"{start}{number}")
        for number in sorted(int(name) for name in names if name.isdecimal())
    ]


@contextlib.contextmanager
def damage_noticed(path: Path) -> Iterator[None]:
    """Raise `Damaged` if the block finds ``path`` damaged."""
    try:
        yield
    except UnicodeDecodeError:  # raised if SQLite's message quotes the damage
        detail = "SQLite's message about it is not UTF-8"
    except sqlite3.Error as error:
        # SQLITE_READONLY is its answer to a header that asks for a newer SQLite, too.
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        writable = os.access(path, os.W_OK) and os.access(path.parent, os.W_OK)
        if code not in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB) and not (
            code == sqlite3.SQLITE_READONLY and writable
        ):
            raise
        detail = str(error)
    else:
        return
    raise Damaged(f"{path} is damaged: {detail}; a start of the program sets it aside")


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


def used_bytes(database: sqlite3.Connection) -> int:
    """Return the size of what a database holds, in bytes."""
    pages, free, size = (
        database.execute(f"PRAGMA {name}").fetchone()[0]
        for name in ("page_count", "freelist_count", "page_size")
    )
    return int((pages - free) * size)


def readable(
    path: Path, table: str, key: str
) -> Iterator[tuple[int | float | str | bytes | None, ...]]:
    """Yield the rows of ``table`` that can still be read from a damaged file, some of them twice.

    They come by rising ``key`` up to the first damaged page, then from the other end. Only a row's
    CRC tells whether it is good. The file is not changed.
    """
    if path.stat().st_size == 0:
        return  # it has no rows, and SQLite would delete the log beside it
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
            except (sqlite3.Error, UnicodeDecodeError) as error:
                log.info("reading %s of %s by %s %s: %s", table, path, key, order, error)


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


@functools.cache
def _shape_of(schema: str) -> frozenset[tuple[object, ...]]:
    """Return the tables, columns and indices that ``schema`` creates."""
    with contextlib.closing(sqlite3.connect(":memory:", isolation_level=None)) as scratch:
        _create(scratch, schema)
        return frozenset(scratch.execute(_SHAPE))
