"""Messages between the daemon and the learner's process, over a pipe of `multiprocessing`.

The daemon asks, and the process gives one answer. Both sides are this program, so an invalid
message is a bug.
"""

from __future__ import annotations

from typing import TypeVar

import msgspec
from msgspec import Struct

from camtopod.event_time import EventTimeState
from camtopod.learn.settings import Settings
from camtopod.records import LearnerCounts
from camtopod.serve.storage import StoredVersion

INPUTS_MAX = 4_000
"""Most entries in one message: some hundred kilobytes, some hundredths of a second without a fit.

Where the daemon's threads are busy, each message waits several times for the GIL, milliseconds
each.
"""

STATE = -1
"""In place of an entry's number: what is done with the state, not with an entry."""

Input = tuple[str, bytes]
"""The ``kind`` and ``raw`` of an entry; a damaged one counts as ``skipped``."""


class Load(Struct):
    """Question: can this state of a learner be used? `Begin` follows. Answer: `Loaded`."""

    state: bytes


class Begin(Struct):
    """Question: begin to learn. Answer: `LearnProgress`.

    load: use the state that was loaded last.
    names: old names of renamed cameras -> present ones, and forgotten names -> ""; used unless the
        state has them.
    """

    settings: Settings
    site: str
    epoch: str
    load: bool
    names: dict[str, str] = {}


class LearnBatch(Struct):
    """Question: learn the entries of the journal after ``position``. Answer: `LearnProgress`.

    The first question after `Begin` is one without entries: make the epoch's first version.
    """

    position: int
    inputs: list[Input]


class Loaded(Struct):
    """The state was saved with these settings, for this site; or it cannot be used.

    version: its version of the topology in its epoch; 0 if it has none.
    reason: why it cannot be used; "" if it can.
    newer: it was saved by a newer program.
    """

    settings: Settings | None = None
    site: str = ""
    epoch: str = ""
    version: int = 0
    reason: str = ""
    newer: bool = False


class NewVersion(Struct):
    """A new version, not stored yet.

    map, model: the two parts of the version, as MessagePack.
    outside: its `camtopod.predict.outside_rates`, which take long.
    delta: difference from the map of the version before, as MessagePack.
    """

    stored: StoredVersion
    map: bytes
    model: bytes
    outside: list[float]
    delta: bytes | None


class LearnProgress(Struct):
    """Everything up to ``position`` is learned, which may be less than was asked for.

    deadline: event time that the learner waits for.
    unreadable: number of events that this program cannot read.
    epoch: epoch of the next versions.
    is_paused: it has more to do before the next entry.
    event_time: at the beginning, the event time.
    versions: those that the last entry has made; no further entry is learned before these and the
        state are taken, as they have to be stored together.
    state: the learner's packed state, after versions and now and then; else None.
    """

    position: int
    deadline: float | None
    statistics: LearnerCounts
    epoch: str
    is_paused: bool = False
    unreadable: int = 0
    event_time: EventTimeState = msgspec.field(default_factory=EventTimeState)
    versions: list[NewVersion] = []
    state: bytes | None = None


Question = Load | Begin | LearnBatch
Answer = Loaded | LearnProgress
Kind = TypeVar("Kind", bound=Answer)
"""The kind of answer that a question has."""
