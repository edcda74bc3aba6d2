"""A VFS on top of Python's sqlite3 that records SQLite's disk operations and makes some fail.

The program under test runs unchanged. All methods but those that change files are the system's.
Those call `watch` first, which may record the operation, or return a `Fault` that replaces it.
"""

from __future__ import annotations

import ctypes
import os
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from ctypes import POINTER, c_char_p, c_int, c_int64, c_void_p
from typing import Any, NamedTuple

FULL = 13
"""SQLITE_FULL: no space left on the device."""
IOERR_WRITE = 10 | 3 << 8
IOERR_FSYNC = 10 | 4 << 8
IOERR_TRUNCATE = 10 | 6 << 8
IOERR_DELETE = 10 | 10 << 8
IOERR_SHMSIZE = 10 | 19 << 8
CANTOPEN = 14
EIO = {
    "create": CANTOPEN,
    "write": IOERR_WRITE,
    "truncate": IOERR_TRUNCATE,
    "sync": IOERR_FSYNC,
    "delete": IOERR_DELETE,
    "shm": IOERR_SHMSIZE,
}
"""Error codes of operations when the device fails."""
_OPEN_CREATE = 0x4
_OPEN_MAIN_DB = 0x100
_OPEN_JOURNALS = 0x800 | 0x4000 | 0x80000  # main journal, super-journal, write-ahead log


class Op(NamedTuple):
    """An operation on the disk.

    ``kind``: create, write, truncate (to ``offset``), sync, delete, shm (more shared memory).
    ``directory``: the operation also makes the directory's entries durable (for create: its first
    sync will).
    """

    kind: str
    path: str
    offset: int = 0
    data: bytes = b""
    directory: bool = False


class Fault(NamedTuple):
    """An error that replaces an operation; ``short``: after half of the bytes were written."""

    code: int
    short: bool = False


Watch = Callable[[Op], Fault | None]
"""Called before every operation."""


def _pointers(names: str) -> list[tuple[str, Any]]:
    return [(name, c_void_p) for name in names.split()]


class _IoMethods(ctypes.Structure):
    _fields_ = [
        ("iVersion", c_int),
        *_pointers(
            "xClose xRead xWrite xTruncate xSync xFileSize xLock xUnlock xCheckReservedLock"
            " xFileControl xSectorSize xDeviceCharacteristics xShmMap xShmLock xShmBarrier"
            " xShmUnmap xFetch xUnfetch"
        ),
    ]


class _File(ctypes.Structure):
    _fields_ = [("methods", POINTER(_IoMethods))]


class _VfsStruct(ctypes.Structure):
    _fields_ = (
        [(name, c_int) for name in ("iVersion", "szOsFile", "mxPathname")]
        + [("pNext", c_void_p), ("zName", c_char_p)]
        + _pointers(
            "pAppData xOpen xDelete xAccess xFullPathname xDlOpen xDlError xDlSym xDlClose"
            " xRandomness xSleep xCurrentTime xGetLastError xCurrentTimeInt64 xSetSystemCall"
            " xGetSystemCall xNextSystemCall"
        )
    )


_OPEN = ctypes.CFUNCTYPE(c_int, c_void_p, c_void_p, c_void_p, c_int, POINTER(c_int))
_DELETE = ctypes.CFUNCTYPE(c_int, c_void_p, c_char_p, c_int)
_CLOSE = ctypes.CFUNCTYPE(c_int, c_void_p)
_WRITE = ctypes.CFUNCTYPE(c_int, c_void_p, c_void_p, c_int, c_int64)
_TRUNCATE = ctypes.CFUNCTYPE(c_int, c_void_p, c_int64)
_SYNC = ctypes.CFUNCTYPE(c_int, c_void_p, c_int)
_SHM_MAP = ctypes.CFUNCTYPE(c_int, c_void_p, c_int, c_int, c_int, c_void_p)


def library() -> ctypes.CDLL | None:
    """Return the SQLite that the module sqlite3 uses, or None if its functions cannot
    be reached.
    """
    import _sqlite3

    candidates = [getattr(_sqlite3, "__file__", None), None]
    with open("/proc/self/maps") as maps:
        candidates[:0] = sorted({line.split()[-1] for line in maps if "libsqlite3" in line})
    for candidate in candidates:
        found = ctypes.CDLL(candidate)
        if hasattr(found, "sqlite3_vfs_register"):
            found.sqlite3_libversion.restype = c_char_p
            if found.sqlite3_libversion().decode() == sqlite3.sqlite_version:
                return found
    return None


class Vfs:
    """The VFS, registered while the process lives; it is the default within `watching`."""

    def __init__(self, sqlite: ctypes.CDLL) -> None:
        sqlite.sqlite3_vfs_find.restype = POINTER(_VfsStruct)
        sqlite.sqlite3_vfs_find.argtypes = [c_char_p]
        sqlite.sqlite3_vfs_register.argtypes = [c_void_p, c_int]
        self._sqlite = sqlite
        self._base = sqlite.sqlite3_vfs_find(None)
        self._watch: Watch = lambda op: None
        self._paths: dict[int, str] = {}
        self._tables: dict[int, _IoMethods] = {}
        self._alive: list[Any] = []
        self._vfs = _VfsStruct.from_buffer_copy(self._base.contents)
        self._vfs.zName = b"faults"
        base_open = _OPEN(self._base.contents.xOpen)
        base_delete = _DELETE(self._base.contents.xDelete)

        def on_open(_: int, name: int | None, file: int, flags: int, out: Any) -> int:
            path = ctypes.string_at(name).decode() if name else ""
            fresh = bool(path) and (
                not os.path.exists(path)
                or (bool(flags & _OPEN_MAIN_DB) and not os.path.getsize(path))
            )
            if fresh and flags & _OPEN_CREATE:
                fault = self._watch(Op("create", path, directory=bool(flags & _OPEN_JOURNALS)))
                if fault is not None:
                    _File.from_address(file).methods = None
                    return fault.code
            code = int(base_open(ctypes.addressof(self._base.contents), name, file, flags, out))
            if code == 0 and path:
                self._paths[file] = path
                self._patch(file)
            return code

        def on_delete(_: int, name: bytes, sync_directory: int) -> int:
            fault = self._watch(Op("delete", name.decode(), directory=bool(sync_directory)))
            if fault is not None:
                return fault.code
            return int(base_delete(ctypes.addressof(self._base.contents), name, sync_directory))

        self._vfs.xOpen = self._pointer(_OPEN(on_open))
        self._vfs.xDelete = self._pointer(_DELETE(on_delete))
        assert sqlite.sqlite3_vfs_register(ctypes.addressof(self._vfs), 0) == 0

    @contextmanager
    def watching(self, watch: Watch) -> Iterator[None]:
        """Watch databases that are opened and used within the block."""
        self._watch = watch
        assert self._sqlite.sqlite3_vfs_register(ctypes.addressof(self._vfs), 1) == 0
        try:
            yield
        finally:
            assert self._sqlite.sqlite3_vfs_register(ctypes.addressof(self._base.contents), 1) == 0
            self._watch = lambda op: None

    def _pointer(self, function: Any) -> int | None:
        self._alive.append(function)
        return ctypes.cast(function, c_void_p).value

    def _patch(self, file: int) -> None:
        """Give an open file our own copy of its table of methods."""
        handle = _File.from_address(file)
        address = ctypes.addressof(handle.methods.contents)
        if address not in self._tables:
            self._tables[address] = self._copy_of(handle.methods.contents)
        handle.methods = ctypes.pointer(self._tables[address])

    def _copy_of(self, base: _IoMethods) -> _IoMethods:
        close, write, truncate = _CLOSE(base.xClose), _WRITE(base.xWrite), _TRUNCATE(base.xTruncate)
        sync, shm_map = _SYNC(base.xSync), _SHM_MAP(base.xShmMap or 0)

        def on_close(file: int) -> int:
            self._paths.pop(file, None)
            return int(close(file))

        def on_write(file: int, data: int, size: int, offset: int) -> int:
            fault = self._watch(
                Op("write", self._paths[file], offset, ctypes.string_at(data, size))
            )
            if fault is None:
                return int(write(file, data, size, offset))
            if fault.short:
                write(file, data, size // 2, offset)
            return fault.code

        def on_truncate(file: int, size: int) -> int:
            fault = self._watch(Op("truncate", self._paths[file], size))
            return int(truncate(file, size)) if fault is None else fault.code

        def on_sync(file: int, flags: int) -> int:
            fault = self._watch(Op("sync", self._paths[file]))
            return int(sync(file, flags)) if fault is None else fault.code

        def on_shm_map(file: int, region: int, size: int, extend: int, out: int) -> int:
            fault = self._watch(Op("shm", self._paths[file])) if extend else None
            return int(shm_map(file, region, size, extend, out)) if fault is None else fault.code

        table = _IoMethods.from_buffer_copy(base)
        table.xClose = self._pointer(_CLOSE(on_close))
        table.xWrite = self._pointer(_WRITE(on_write))
        table.xTruncate = self._pointer(_TRUNCATE(on_truncate))
        table.xSync = self._pointer(_SYNC(on_sync))
        if base.xShmMap:  # a log has none
            table.xShmMap = self._pointer(_SHM_MAP(on_shm_map))
        return table


_found = library() if os.path.exists("/proc/self/maps") else None
VFS = Vfs(_found) if _found is not None else None
"""The VFS, or None where SQLite's functions cannot be reached."""
