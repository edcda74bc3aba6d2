"""Messages between the daemon and the learner's process, over two pipes and shared memory.

The daemon asks; the process answers with any number of `NewVersion` and `VersionMismatch`, then
with one of the other answers. A message is its length, and its MessagePack. Both sides are this
program, so an invalid message is a bug.
"""

from __future__ import annotations

import mmap
import os
import struct
from collections.abc import Callable
from typing import Any

import msgspec
from msgspec import Struct

from camtopod.admin import Command
from camtopod.event_time import EventTimeState
from camtopod.learn import Settings
from camtopod.serve.storage import Rewind

INPUTS_MAX = 4_000
"""Most entries in one message: some hundred kilobytes, some hundredths of a second without a fit.

Where the daemon's threads are busy, each message waits several times for the GIL, milliseconds
each.
"""
READ_BYTES_MAX = 1 << 20
"""Most bytes of one read from a pipe."""
OUT_OF_MEMORY = 71
"""Exit status of the learner's process when it runs out of memory."""
_LENGTH = struct.Struct("<Q")
"""The length before each message, in bytes."""


Input = bytes | float | Rewind | Command | None
"""What the learner needs of a journal entry.

It is an event as it was received, an event time to advance to, a rewind of event time, an
operator's command, or nothing.
"""


class Load(Struct, tag=True):
    """Question: can this state of a learner be used? `Begin` follows.

    Answer: `Loaded` or `Unusable`.
    """

    state: bytes


class Begin(Struct, tag=True):
    """Question: begin to learn. Answer: `LearnProgress`.

    stored: digests of the epoch's versions that may have been published.
    load: use the state that was loaded last.
    without: cameras to leave out of the loaded state.
    """

    settings: Settings
    site: str
    epoch: str
    stored: dict[int, str]
    load: bool
    without: list[str] = []


class Refresh(Struct, tag=True):
    """Question: make the epoch's first version; asked once before any `LearnBatch`.

    Answer: `LearnProgress`.
    """

    position: int


class LearnBatch(Struct, tag=True):
    """Question: learn the entries of the journal after ``position``. Answer: `LearnProgress`."""

    position: int
    lessons: list[Input]


class NewEpoch(Struct, tag=True):
    """Reply of the daemon to `VersionMismatch`."""

    epoch: str


class Show(Struct, tag=True):
    """Question for the newest version. Answer: `Shown`."""


class Save(Struct, tag=True):
    """Question for the learner's state. Answer: `Saved`."""


class Loaded(Struct, tag=True):
    """The state can be used; it was saved with these settings, for this site and epoch."""

    settings: Settings
    site: str
    epoch: str


class Unusable(Struct, tag=True):
    """The state cannot be used; ``newer``: it was saved by a newer program."""

    reason: str
    newer: bool


class NewVersion(Struct, tag=True):
    """A new version, not stored yet.

    content, packed: the version as JSON and as MessagePack.
    delta: difference from the version before, as MessagePack.
    """

    epoch: str
    version: int
    digest: str
    content: bytes
    packed: bytes
    delta: bytes | None


class VersionMismatch(Struct, tag=True):
    """A stored version was not reproduced: its digest differs. Learning waits for a `NewEpoch`."""

    version: int


class LearnProgress(Struct, tag=True):
    """Progress: everything up to ``position`` is learned, less than was asked for if time ran out.

    deadline: event time that the learner waits for.
    unreadable: number of events that this program cannot read.
    epoch: epoch of the next versions.
    event_time: at the beginning, the event time.
    """

    position: int
    deadline: float | None
    statistics: dict[str, int | float]
    unreadable: int
    event_time: EventTimeState = msgspec.field(default_factory=EventTimeState)
    epoch: str = ""


class Shown(Struct, tag=True):
    """The newest version as MessagePack, None before the first."""

    packed: bytes | None


class Saved(Struct, tag=True):
    """The learner's state, packed."""

    state: bytes


Question = Load | Begin | Refresh | LearnBatch | NewEpoch | Show | Save
Answer = Loaded | Unusable | NewVersion | VersionMismatch | LearnProgress | Shown | Saved

_questions = msgspec.msgpack.Decoder(Question)
_answers = msgspec.msgpack.Decoder(Answer)


def send(fd: int, message: Question | Answer) -> None:
    """Write a message; raise `BrokenPipeError` if the other side has ended."""
    body = msgspec.msgpack.encode(message)
    for part in (_LENGTH.pack(len(body)), body):
        rest = memoryview(part)
        while rest:
            rest = rest[os.write(fd, rest) :]


def read_question(fd: int) -> Question:
    """Read a question; raise `EOFError` at the end."""
    asked: Question = _read(fd, _questions.decode)
    return asked


def read_answer(fd: int) -> Answer:
    """Read an answer; raise `EOFError` at the end."""
    told: Answer = _read(fd, _answers.decode)
    return told


def _read(fd: int, decode: Callable[[bytearray], Any]) -> Any:
    (length,) = _LENGTH.unpack(_exactly(fd, _LENGTH.size))
    return decode(_exactly(fd, length))


def _exactly(fd: int, length: int) -> bytearray:
    whole = bytearray()
    while len(whole) < length:
        part = os.read(fd, min(length - len(whole), READ_BYTES_MAX))
        if not part:
            raise EOFError
        whole += part
    return whole


class SharedStatus:
    """Shared memory: the entry that is being learned, and a request to end soon.

    It can be read even after the process was killed, and costs less than a message for each entry.
    """

    _AT, _HURRY = 0, 1

    def __init__(self, fd: int | None = None) -> None:
        """Create a board, or open that of another process by its file descriptor ``fd``."""
        self.fd = os.memfd_create("learner") if fd is None else fd
        if fd is None:
            os.ftruncate(self.fd, mmap.PAGESIZE)
        self._memory = mmap.mmap(self.fd, mmap.PAGESIZE)
        self._cells = memoryview(self._memory).cast("q")

    @property
    def at(self) -> int:
        """The entry of the journal that is being learned; 0: none."""
        return int(self._cells[self._AT])

    @at.setter
    def at(self, entry: int) -> None:
        """Set by the learner's process before each entry."""
        self._cells[self._AT] = entry

    @property
    def hurry(self) -> bool:
        """True if the process should end its step after the present entry."""
        return self._cells[self._HURRY] != 0

    @hurry.setter
    def hurry(self, hurry: bool) -> None:
        """Set by the daemon."""
        self._cells[self._HURRY] = hurry

    def close(self) -> None:
        """Close the board in this process."""
        self._cells.release()
        self._memory.close()
        os.close(self.fd)
