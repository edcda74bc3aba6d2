"""How much of SQLite's write-ahead log is lost: SQLite itself takes a damaged log for a shorter one
and says nothing.

The layout is that of https://www.sqlite.org/fileformat2.html#walformat and
https://www.sqlite.org/walformat.html.
"""

from __future__ import annotations

import os
import struct
import sys
from pathlib import Path
from typing import NamedTuple

_MAGIC = (0x377F0682, 0x377F0683)
_HEADER_BYTES = 32
_FRAME_HEADER_BYTES = 24
_LAST_FRAME_AT = 16
"""Where the index of the log says how many frames are good."""
INDEX_BYTES = 100
"""The beginning of the index: its header, a copy of that, and the number of frames copied into the
database.
"""


class Log(NamedTuple):
    """What is written in a log, good or not. ``frames``: the number, from 1, of each that belongs
    to the log as it was begun last; ``commits``: of each that ends a transaction. ``headless``: the
    beginning is damaged.
    """

    frames: list[int]
    commits: list[int]
    headless: bool = False


class Lost(NamedTuple):
    """``frames`` that SQLite leaves out, and among them ``transactions`` that had been written to
    their end.

    At a kill or a power cut one may have been on its way; more than one, or a damaged head, is
    damage.
    """

    frames: int
    transactions: int
    headless: bool

    @property
    def damaged(self) -> bool:
        """Whether this cannot be the work of a kill or a power cut."""
        return self.headless or self.transactions > 1


def read(path: Path) -> Log:
    """The log of the database ``path``, before SQLite opens it. Raises `OSError`."""
    try:
        with Path(f"{path}-wal").open("rb") as file:
            head = file.read(_HEADER_BYTES)
            if len(head) < _HEADER_BYTES:
                return Log([], [])
            magic, _, page_bytes, _, *salts = struct.unpack(">6I", head[:24])
            if magic not in _MAGIC or _checksum(
                head[:24], big_endian=magic & 1 == 1
            ) != struct.unpack(">2I", head[24:]):
                return Log(
                    [], [], headless=len(file.read(_FRAME_HEADER_BYTES)) == _FRAME_HEADER_BYTES
                )
            found = Log([], [])
            number = 0
            while len(frame := file.read(_FRAME_HEADER_BYTES)) == _FRAME_HEADER_BYTES:
                number += 1
                _, pages, *own = struct.unpack(">4I", frame[:16])
                if own == salts:
                    found.frames.append(number)
                    if pages:
                        found.commits.append(number)
                file.seek(page_bytes, 1)
            if frame:
                found.frames.append(number + 1)
            return found
    except FileNotFoundError:
        return Log([], [])


def open_index(path: Path) -> int | None:
    """A descriptor of the log's index (shared memory), while SQLite has the database open; None:
    there is none. To be kept until SQLite has closed it, too: who closes a file loses all locks of
    the process on it, also SQLite's, and the next process that reads the database would cut off the
    memory under this one. Raises `OSError`.
    """
    try:
        return os.open(f"{path}-shm", os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return None


def lost(path: Path, log: Log, index: int | None) -> Lost:
    """What of ``log`` SQLite, which has the database open by now, has left out; ``index``: see
    `open_index`. Raises `OSError`.
    """
    last = 0 if index is None else int.from_bytes(os.pread(index, 4, _LAST_FRAME_AT), sys.byteorder)
    transactions = sum(
        one > last and _is_frame_whole(path, one) for one in log.commits
    )  # 0 is of a log that has gone
    return Lost(sum(one > last for one in log.frames), transactions, log.headless)


def is_whole(log: int, size: int, index: bytes) -> bool:
    """Return True if an open log agrees with its index: its length, its beginning and its last
    frame.

    ``log``: a descriptor of the log; ``size``: its bytes; ``index``: the first `INDEX_BYTES` of its
    index. Raises `OSError`.
    """
    page_bytes, last, *sums = struct.unpack("=14xHI4x2I", index[:32])
    salts = index[32:40]
    if last == 0:
        return True  # the log has begun anew and is empty

    frame_bytes = _FRAME_HEADER_BYTES + (2**16 if page_bytes == 1 else page_bytes)
    if size < _HEADER_BYTES + last * frame_bytes:
        return False

    head = os.pread(log, _HEADER_BYTES, 0)
    frame = os.pread(log, _FRAME_HEADER_BYTES, _HEADER_BYTES + (last - 1) * frame_bytes)
    return head[16:24] == frame[8:16] == salts and frame[16:] == struct.pack(">2I", *sums)


def _is_frame_whole(path: Path, frame: int) -> bool:
    """Whether a frame is as it was written, going by the one before it: two that were torn can look
    like one.
    """
    with Path(f"{path}-wal").open("rb") as file:
        head = file.read(_HEADER_BYTES)
        magic, _, page_bytes = struct.unpack(">3I", head[:12])
        if frame == 1:
            before = head[24:]
        else:
            file.seek(_HEADER_BYTES + (frame - 2) * (_FRAME_HEADER_BYTES + page_bytes) + 16)
            before = file.read(8)
        file.seek(_HEADER_BYTES + (frame - 1) * (_FRAME_HEADER_BYTES + page_bytes))
        own, page = file.read(_FRAME_HEADER_BYTES), file.read(page_bytes)
    if len(page) < page_bytes:
        return False
    first, second = struct.unpack(">2I", before)
    return _checksum(own[:8] + page, magic & 1 == 1, first, second) == struct.unpack(
        ">2I", own[16:]
    )


def _checksum(data: bytes, big_endian: bool, first: int = 0, second: int = 0) -> tuple[int, int]:
    words = struct.unpack(f"{'>' if big_endian else '<'}{len(data) // 4}I", data)
    for even, odd in zip(words[::2], words[1::2], strict=True):
        first = (first + even + second) & 0xFFFFFFFF
        second = (second + odd + first) & 0xFFFFFFFF
    return first, second
