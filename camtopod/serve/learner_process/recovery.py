"""Recover the learner at a start: from the newest usable snapshot, else from the oldest entry.

An epoch is a sequence of versions that results from one unbroken history of events, settings and
program. When that can no longer be guaranteed a new epoch begins, with everything that is known.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Sequence
from typing import NamedTuple

import msgspec

from camtopod import codec
from camtopod.admin import Reset, Rewind
from camtopod.event_time import EventTime, EventTimeState, microseconds
from camtopod.learn.settings import LearnSettings, Settings
from camtopod.records import Event, Topology
from camtopod.serve.learner_process.messages import STATE, Begin, LearnProgress, Load, Loaded
from camtopod.serve.learner_process.process import LearnerProcess
from camtopod.serve.storage import Entry, Journal, StateError, read_command

log = logging.getLogger(__name__)

DEATHS_MAX = 2
"""Number of deaths of the learner at one entry, or at its state, after which that is left out."""
RECENT_ENTRIES = 20_000
"""Number of entries of the journal, the newest, whose events are remembered at a start."""


class Failure(msgspec.Struct):
    """The learner has died ``times`` times at the entry ``at``, or at its `STATE`."""

    at: int
    times: int


class Recovered(NamedTuple):
    """State of the learner at the start.

    position: number of the last entry of the journal that it has learned.
    """

    position: int
    progress: LearnProgress


def recover(
    journal: Journal,
    process: LearnerProcess,
    settings: Settings,
    site: str,
    new_epoch: Callable[[], str],
    names: dict[str, str],
) -> Recovered:
    """Load the learner into ``process`` and return its state.

    Raises `StateError`, and `LearnerEnded` for `note_failure`.

    new_epoch: begins an epoch and stores its name.
    names: old names of renamed cameras -> present ones; forgotten names -> "".
    """
    failure = read_failure(journal)
    is_fatal = failure.times >= DEATHS_MAX

    # Begin with the newest usable snapshot, else with all entries.
    epoch = journal.meta("epoch") or new_epoch()
    if is_fatal and failure.at == STATE:
        position = max(
            [journal.first() - 1, 0, *(snapshot.position for snapshot in journal.snapshots())]
        )
        origin = Loaded()
    else:
        if is_fatal:
            journal.skip(failure.at)
        position, origin = _newest_state(journal, process)

    # Entries that follow may begin further epochs, the last of which is the journal's.
    epochs = [
        _epochs(entry) for *_, entry in journal.commands(position) if entry.kind == "correction"
    ]
    if epochs and epochs[-1][1] == epoch:
        epoch = epochs[0][0]

    # Begin an epoch without what the learner has died of twice: an entry, or the state above. Begin
    # one, too, where versions would be made anew that may have been published.
    version = origin.version if origin.epoch == epoch else 0
    if is_fatal:
        epoch = new_epoch()
        place = f"entry {failure.at} of the journal, which is skipped"
        if failure.at == STATE:
            place = "the state that it continued from: it begins with nothing"
        log.error("the learner has died twice at %s, in epoch %s; please report this", place, epoch)
        journal.set_meta("failure", codec.to_json(Failure(0, 0)).decode())
    elif version < max(journal.versions(epoch), default=0):
        epoch = new_epoch()
        log.warning(
            "no snapshot goes with the newest version of the journal: epoch %s begins", epoch
        )
    elif origin.settings is not None and (origin.settings, origin.site) != (settings, site):
        epoch = new_epoch()
        log.warning(
            "settings of the learner have changed: epoch %s begins with what has been learned",
            epoch,
        )

    begin = Begin(settings, site, epoch, origin.settings is not None, names)
    progress = process.ask(begin, LearnProgress)
    return Recovered(position, progress)


def _epochs(entry: Entry) -> tuple[str, str]:
    """Return the epochs that a correction ends and begins. Raises `codec.Rejected`."""
    command = read_command(entry.raw)
    assert isinstance(command, Reset | Rewind)
    return command.before, command.epoch


def event_time(
    journal: Journal, recovery: Recovered, learn: LearnSettings, recent: Sequence[tuple[int, Event]]
) -> EventTime:
    """Return event time as the learner will have it after the stored entries.

    recent: see `recent_events`.
    """
    time = EventTime(learn.lateness_seconds, learn.ahead_seconds_max)
    time.load(recovery.progress.event_time)
    for *_, entry in journal.commands(recovery.position):
        with contextlib.suppress(codec.Rejected):  # by another version
            match read_command(entry.raw):
                case Reset():
                    time.load(EventTimeState())
                case Rewind(to):
                    time.rewind(microseconds(to))
    for *_, entry in journal.commands(recovery.position, "('waits')")[-1:]:
        time.wait_for(codec.read(set[str], entry.raw))
    for _, event in recent:
        time.note(microseconds(event.t), event.camera)
    return time


def newest_topology(journal: Journal) -> Topology | None:
    """Return the newest version that can be read, of any epoch; it is valid until the next."""
    content = journal.newest_version()
    if content is None:
        return None
    try:
        return codec.read_topology(content)
    except codec.Rejected as error:
        log.error("the newest version in the journal cannot be read: %s", error)
        return None


def recent_events(journal: Journal) -> list[tuple[int, Event]]:
    """Return the newest events since the last correction, with their numbers, by time."""
    events: list[tuple[int, Event]] = []
    for number, entry in journal.entries(after=max(0, len(journal) - RECENT_ENTRIES)):
        if entry is not None and entry.kind == "correction":
            events.clear()
        elif entry is not None and entry.kind == "event":
            with contextlib.suppress(codec.Rejected):  # accepted by another version
                events.append((number, codec.event_from_bytes(entry.raw)))
    return sorted(events, key=lambda pair: pair[1].t)


def read_failure(journal: Journal) -> Failure:
    """Return the last failure of the learner, if any, which may be past that entry by now."""
    content = journal.meta("failure")
    return Failure(0, 0) if content is None else codec.read(Failure, content.encode())


def note_failure(journal: Journal, at: int) -> None:
    """Note that the learner died at the entry ``at``, or at its `STATE`; 0: it did nothing."""
    if not at:
        return
    failure = read_failure(journal)
    if failure.at != at:
        failure = Failure(at, 0)
    failure.times += 1
    journal.set_meta("failure", codec.to_json(failure).decode())


def _newest_state(journal: Journal, process: LearnerProcess) -> tuple[int, Loaded]:
    """Load the newest snapshot that can be used into ``process``.

    Returns the number of the last entry that it has learned, and the answer. Without one, that is
    the entry before the oldest.

    Snapshots are tried from the newest on. One that cannot be read is logged, and the one before it
    is tried; one of a newer program raises `StateError`.
    """
    for snapshot in journal.snapshots():
        origin = process.ask(Load(snapshot.state), Loaded)
        if not origin.reason:
            return snapshot.position, origin
        if origin.newer:
            raise StateError(
                f"the snapshot was saved by a newer camtopod ({origin.reason}): use that version"
            )
        log.error("the snapshot at entry %d cannot be used: %s", snapshot.position, origin.reason)
    return max(journal.first() - 1, 0), Loaded()
