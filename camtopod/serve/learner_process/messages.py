"""Messages between the daemon and the learner's process, over a pipe of `multiprocessing`.

The daemon asks; the process answers with any number of `NewVersion` and `VersionMismatch`, then
with one of the other answers. Both sides are this program, so an invalid message is a bug.
"""

from __future__ import annotations

from typing import TypeVar

import msgspec
from msgspec import Struct

from camtopod.event_time import EventTimeState
from camtopod.learn.settings import Settings

INPUTS_MAX = 4_000
"""Most entries in one message: some hundred kilobytes, some hundredths of a second without a fit.

Where the daemon's threads are busy, each message waits several times for the GIL, milliseconds
each.
"""

Input = tuple[str, bytes]
"""The ``kind`` and ``raw`` of an entry; a damaged one counts as ``skipped``."""


class Load(Struct):
    """Question: can this state of a learner be used? `Begin` follows.

    Answer: `Loaded`.
    """

    state: bytes


class Begin(Struct):
    """Question: begin to learn. Answer: `LearnProgress`.

    stored: digests of versions that may have been published, by version and epoch; of this epoch
        and of those that entries of the journal begin.
    load: use the state that was loaded last.
    """

    settings: Settings
    site: str
    epoch: str
    stored: dict[str, dict[int, str]]
    load: bool


class LearnBatch(Struct):
    """Question: learn the entries of the journal after ``position``. Answer: `LearnProgress`.

    The first question after `Begin` is one without entries: make the epoch's first version.
    """

    position: int
    inputs: list[Input]


class NewEpoch(Struct):
    """Reply of the daemon to `VersionMismatch`."""

    epoch: str


class Save(Struct):
    """Question for the learner's state. Answer: `Saved`."""


class Loaded(Struct):
    """The state was saved with these settings, for this site; or it cannot be used.

    reason: why it cannot be used; "" if it can.
    newer: it was saved by a newer program.
    """

    settings: Settings | None = None
    site: str = ""
    reason: str = ""
    newer: bool = False


class NewVersion(Struct):
    """A new version, not stored yet.

    content, packed: the version as JSON and as MessagePack.
    delta: difference from the version before, as MessagePack.
    """

    content: bytes
    packed: bytes
    delta: bytes | None


class VersionMismatch(Struct):
    """A stored version was not reproduced: its digest differs. Learning waits for a `NewEpoch`."""

    version: int


class LearnProgress(Struct):
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


class Saved(Struct):
    """The learner's state, packed."""

    state: bytes


Question = Load | Begin | LearnBatch | NewEpoch | Save
Answer = Loaded | NewVersion | VersionMismatch | LearnProgress | Saved
Kind = TypeVar("Kind", bound=Answer)
"""The kind of answer that a question has."""
