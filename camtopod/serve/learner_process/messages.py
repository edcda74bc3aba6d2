"""What the daemon and the learner's process say to each other, in turns, over two pipes and a piece
of memory.

The daemon asks; the process answers with any number of `Made` and `Otherwise`, then with one of the
others. A message is its length and itself as MessagePack. Both are this program: what does not fit
is a mistake in it.
"""

from __future__ import annotations

import mmap
import os
import struct
from collections.abc import Callable
from typing import Any

import msgspec
from msgspec import Struct

from camtopod.event_time import EventTimeState
from camtopod.learn import Settings
from camtopod.serve.storage import Rewind
from camtopod.sharding import Part, Sharding

LESSONS_MAX = 4_000
"""In one message: some hundred kilobytes, some hundredths of a second without a fit. Where the
daemon's threads are busy each message costs it several turns of waiting for the interpreter,
milliseconds each."""
READ_BYTES_MAX = 1 << 20
OUT_OF_MEMORY = 71
"""Exit status of the learner's process when it was refused memory."""
_LENGTH = struct.Struct("<Q")


Lesson = bytes | float | Rewind | None
"""What an entry of the journal teaches: an event as it was received, that event time has come so
far, that it has to go back, nothing."""


class Portion(Struct, frozen=True):
    """Shard ``shard`` = (i, n) of a site dealt out like this."""

    sharding: Sharding
    shard: tuple[int, int]


class Load(Struct, tag=True):
    """Is this the state of a learner, or of a shard's? To be followed by `Begin`. Answer: `Loaded`
    or `Unusable`.
    """

    state: bytes
    sharded: bool = False


class Begin(Struct, tag=True):
    """A learner, with what was loaded last if anything was. ``stored``: digests of the epoch's
    versions that may have been published; ``portion``: none for the whole site; ``without``:
    cameras that are left out of what was loaded. Answer: `Taught`.
    """

    settings: Settings
    site: str
    epoch: str
    stored: dict[int, str]
    load: bool
    portion: Portion | None = None
    without: list[str] = []


class Refresh(Struct, tag=True):
    """Make the first version of the epoch of what is known; to be asked once, before any lesson.
    Answer: `Taught`.
    """

    position: int


class Teach(Struct, tag=True):
    """The entries of the journal behind ``position``. Answer: `Taught`."""

    position: int
    lessons: list[Lesson]


class NewEpoch(Struct, tag=True):
    """What `Otherwise` is told."""

    epoch: str


class Show(Struct, tag=True):
    """The newest version, please. Answer: `Shown`."""


class Save(Struct, tag=True):
    """Everything learned, please. Answer: `Saved`."""


class Loaded(Struct, tag=True):
    """It is, of these settings and this site and epoch."""

    settings: Settings
    site: str
    epoch: str
    portion: Portion | None = None


class Unusable(Struct, tag=True):
    """It is not; or it is ``newer`` than this program."""

    reason: str
    newer: bool


class Made(Struct, tag=True):
    """A new version, not stored yet, as JSON and MessagePack; what changed since the one before, as
    MessagePack; and of a shard what the others are told with it, as MessagePack.
    """

    epoch: str
    version: int
    digest: str
    content: bytes
    packed: bytes
    delta: bytes | None
    told: bytes | None = None


class Otherwise(Struct, tag=True):
    """A stored version has come out with another digest. Nothing more is learned before there is a
    `NewEpoch`.
    """

    version: int


class Taught(Struct, tag=True):
    """Everything up to ``position`` is learned, which is less than was asked if there was no time.
    ``deadline``: event time at which time may have to be said to have gone on; ``unreadable``:
    events that could not be read any more; ``epoch``: that of the versions to come. Of a shard:
    what it has ``reached``, and its ``strangers``, None if they are those it said last. At the
    beginning: how far ``event_time`` has come, in a shard in the district that has come furthest.
    """

    position: int
    deadline: float | None
    statistics: dict[str, int | float]
    unreadable: int
    reached: float | None = None
    strangers: list[str] | None = None
    event_time: EventTimeState = msgspec.field(default_factory=EventTimeState)
    epoch: str = ""


class Shown(Struct, tag=True):
    """The newest version as MessagePack, None before the first; and of a shard what the others are
    told with it.
    """

    packed: bytes | None
    told: bytes | None = None


class Saved(Struct, tag=True):
    """The packed state."""

    state: bytes


Question = Load | Begin | Refresh | Teach | NewEpoch | Show | Save
Answer = Loaded | Unusable | Made | Otherwise | Taught | Shown | Saved

_questions = msgspec.msgpack.Decoder(Question)
_answers = msgspec.msgpack.Decoder(Answer)


def send(fd: int, message: Question | Answer) -> None:
    """Write a message. Raises `BrokenPipeError` when nobody reads any more."""
    body = msgspec.msgpack.encode(message)
    for part in (_LENGTH.pack(len(body)), body):
        rest = memoryview(part)
        while rest:
            rest = rest[os.write(fd, rest) :]


def question(fd: int) -> Question:
    """Read one. Raises `EOFError` at the end."""
    asked: Question = _read(fd, _questions.decode)
    return asked


def answer(fd: int) -> Answer:
    """Read one. Raises `EOFError` at the end."""
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


class Board:
    """Memory that both see: what is being learned at this moment, and that it should end soon. It
    tells even of a process that was killed, and costs less than a message for every entry.
    """

    _AT, _HURRY = 0, 1

    def __init__(self, fd: int | None = None) -> None:
        """``fd``: of the board of another process, for which this one gives it as `fd`."""
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
        """By the process that learns, before each entry."""
        self._cells[self._AT] = entry

    @property
    def hurry(self) -> bool:
        """Whether to end after this entry."""
        return self._cells[self._HURRY] != 0

    @hurry.setter
    def hurry(self, hurry: bool) -> None:
        """By the process that waits for the other."""
        self._cells[self._HURRY] = hurry

    def close(self) -> None:
        """No more of it in this process."""
        self._cells.release()
        self._memory.close()
        os.close(self.fd)


class Told(Struct):
    """On ``part/{shard}``: parts of a shard's districts in the order they were made, and the event
    time (seconds) up to which it has told all there are, none where nothing has come yet. A
    question is answered with the newest of each.
    """

    shard: int
    shards: int
    reached: float | None
    parts: list[Part] = []
