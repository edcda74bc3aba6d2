"""Find out how much of a write-ahead log is lost; SQLite silently takes a damaged one as shorter.

The layout is that of https://www.sqlite.org/fileformat2.html#walformat and
https://www.sqlite.org/walformat.html. The log's index is the shared memory file ``-shm``.
"""

from __future__ import annotations

import os
import struct
import sys
from pathlib import Path
from typing import NamedTuple

_MAGIC = (0x377F0682, 0x377F0683)
"""First word of a log: checksums over little-endian and over big-endian words."""
_HEADER_BYTES = 32
"""Size of the log's header, in bytes."""
_FRAME_HEADER_BYTES = 24
"""Size of a frame's header, in bytes; a page of the database follows."""
_LAST_FRAME_AT = 16
"""Offset in the index, in bytes, of the number of valid frames."""
INDEX_BYTES = 100
"""Size of the beginning of the index, in bytes.

It has the index's header, a copy of that, and the number of frames copied into the database.
"""


class Log(NamedTuple):
    """The frames written in a log, valid or not; their numbers begin with 1.

    frames: those that belong to the log since it was last restarted.
    commits: those of them that end a transaction.
    headless: True if the log's header is damaged.
    """

    frames: list[int]
    commits: list[int]
    headless: bool = False


class Lost(NamedTuple):
    """The part of a log that SQLite ignores.

    frames: number of frames ignored.
    transactions: number of those that end a transaction and are complete.

    After a kill or a power cut there may be one such transaction, which was being written; more
    than one, or a damaged header, is damage.
    """

    frames: int
    transactions: int
    headless: bool

    @property
    def damaged(self) -> bool:
        """True if this cannot be the result of a kill or a power cut."""
        return self.headless or self.transactions > 1


def read(path: Path) -> Log:
    """Return what is written in the log of the database ``path``, before SQLite opens it.

    Raises `OSError`.
    """
    try:
        with Path(f"{path}-wal").open("rb") as file:
            # Check the header.
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

            # Walk the frames, and keep the numbers of those with the salts of the header.
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
    """Return a descriptor of the log's index, which SQLite has open; None if there is none.

    Keep it open until SQLite has closed the database: a process that closes a file loses all its
    locks on it, SQLite's included, and the next process that reads the database would truncate the
    shared memory under this one. Raises `OSError`.
    """
    try:
        return os.open(f"{path}-shm", os.O_RDONLY | os.O_CLOEXEC)
    except FileNotFoundError:
        return None


def lost(path: Path, log: Log, index: int | None) -> Lost:
    """Return the part of ``log`` that SQLite, which has the database open by now, has ignored.

    index: the descriptor of `open_index`.

    Raises `OSError`.
    """

    # Number of the last frame that SQLite uses; 0 if it uses none.
    last = 0 if index is None else int.from_bytes(os.pread(index, 4, _LAST_FRAME_AT), sys.byteorder)
    transactions = sum(one > last and _is_frame_whole(path, one) for one in log.commits)
    return Lost(sum(one > last for one in log.frames), transactions, log.headless)


def is_whole(log: int, size: int, index: bytes) -> bool:
    """Return True if an open log agrees with its index in length, header and last frame.

    log: a descriptor of the log.
    size: its length in bytes.
    index: the first `INDEX_BYTES` of its index.

    Raises `OSError`.
    """
    page_bytes, last, *sums = struct.unpack("=14xHI4x2I", index[:32])
    salts = index[32:40]
    if last == 0:
        return True  # the log was restarted and is empty

    frame_bytes = _FRAME_HEADER_BYTES + (2**16 if page_bytes == 1 else page_bytes)
    if size < _HEADER_BYTES + last * frame_bytes:
        return False

    head = os.pread(log, _HEADER_BYTES, 0)
    frame = os.pread(log, _FRAME_HEADER_BYTES, _HEADER_BYTES + (last - 1) * frame_bytes)
    return head[16:24] == frame[8:16] == salts and frame[16:] == struct.pack(">2I", *sums)


def _is_frame_whole(path: Path, frame: int) -> bool:
    """Return True if a frame is as it was written, by its checksum.

    The checksum continues that of the frame before: otherwise two torn frames could look like one.
    """

    # Read the checksum of the frame before (or of the header), and the frame.
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

    # Compare the checksum.
    first, second = struct.unpack(">2I", before)
    return _checksum(own[:8] + page, magic & 1 == 1, first, second) == struct.unpack(
        ">2I", own[16:]
    )


def _checksum(data: bytes, big_endian: bool, first: int = 0, second: int = 0) -> tuple[int, int]:
    """Return SQLite's checksum of ``data``, continued from (``first``, ``second``)."""
    words = struct.unpack(f"{'>' if big_endian else '<'}{len(data) // 4}I", data)
    for even, odd in zip(words[::2], words[1::2], strict=True):
        first = (first + even + second) & 0xFFFFFFFF
        second = (second + odd + first) & 0xFFFFFFFF
    return first, second
