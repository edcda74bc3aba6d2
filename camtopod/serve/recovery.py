"""Where the learner goes on after a start: from its newest snapshot that can be read, else from the oldest event kept.

An epoch is a line of versions that one unbroken history of events, settings and program leads to. Where that cannot
be promised any more a new one begins, with everything that is known.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import NamedTuple

import msgspec

from camtopod import codec
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.learn.snapshot import LearnerState, NewerSnapshot, SnapshotError, unpack
from camtopod.records import Event, Topology
from camtopod.serve.cameras import Received
from camtopod.serve.database import StateError
from camtopod.serve.journal import Entry, Journal
from camtopod.serve.receiver import decode

log = logging.getLogger(__name__)

FAILURES_MAX = 2
"""When the learner has failed so often at one and the same entry it begins anew behind it."""
RECENT_EVENTS, RECENT_SECONDS = 4_000, 600.0
"""At most so many events of the last minutes before the start, which predictions remember."""


class Failure(msgspec.Struct):
    """The learner failed ``times`` times at the entry ``at``."""

    at: int
    times: int


class Recovered(NamedTuple):
    """A learner that has learned the journal's entries up to ``position``."""

    learner: Learner
    position: int
    epoch: str


def recover(journal: Journal, settings: Settings, site: str, new_epoch: Callable[[], str]) -> Recovered:
    """The learner to go on with. ``new_epoch`` begins one and stores its name. Raises `StateError`."""
    epoch = journal.meta("epoch")
    if epoch is None:
        epoch = new_epoch()
    for damaged in journal.damaged_logs()[-1:]:
        if journal.meta("damaged log") != damaged.name:
            epoch = new_epoch()
            log.warning("what the damaged log had in it may have been published: epoch %s begins", epoch)
            journal.set_meta("damaged log", damaged.name)
    failure, found = read_failure(journal), _newest_state(journal)
    beyond = 0 if found is None else found[0]
    if failure is not None and failure.times >= FAILURES_MAX and beyond < failure.at:
        epoch = new_epoch()
        log.error(
            "the learner has failed %d times at entry %d of the journal: it begins anew behind it, in epoch %s; "
            "the entries up to there are still in the journal, please report this", failure.times, failure.at, epoch,
        )  # fmt: skip
        return Recovered(Learner(settings, site, epoch), failure.at, epoch)
    if found is None:
        if journal.first() != 1 and journal.versions(epoch):
            epoch = new_epoch()
            log.warning("the oldest events are not kept any more and there is no snapshot: epoch %s begins", epoch)
        return Recovered(Learner(settings, site, epoch), max(journal.first() - 1, 0), epoch)
    position, state = found
    if (state.settings, state.site) != (settings, site):
        epoch = new_epoch()
        log.warning("settings of the learner have changed: with what is known, epoch %s begins", epoch)
    learner = Learner(settings, site, epoch)
    learner.load(state)
    if state.epoch != epoch:
        learner.begin_epoch(epoch)
    return Recovered(learner, position, epoch)


def newest_topology(journal: Journal, learner: Learner) -> Topology | None:
    """The version that was published last, of whatever epoch; until there is another it still holds."""
    content = journal.newest_version()
    if content is None:
        return learner.topology
    try:
        return codec.read(Topology, content)
    except codec.Rejected as error:
        log.error("the newest version in the journal cannot be read any more: %s", error)
        return learner.topology


def received(entry: Entry) -> Received:
    """An entry as it came; without its event if that cannot be read any more."""
    if entry.kind == "advance":
        return Received(entry, advance=float(entry.raw))
    if entry.kind == "event":
        try:
            return Received(entry, decode(entry.raw))
        except codec.Rejected as error:  # another program accepted it
            log.error("an entry of the journal cannot be read any more: %s", error)
    return Received(entry)


def recent_events(journal: Journal) -> list[Event]:
    """The newest events of the journal, for predictions to remember."""
    entries = journal.entries(after=max(0, len(journal) - RECENT_EVENTS))
    events = [event for _, entry in entries if entry is not None and (event := received(entry).event) is not None]
    newest = max((event.t for event in events), default=0.0)
    return [event for event in events if event.t > newest - RECENT_SECONDS]


def read_failure(journal: Journal) -> Failure | None:
    """Where the learner failed last; it may have got beyond that since."""
    kept = journal.meta("failure")
    return None if kept is None else codec.read(Failure, kept.encode())


def note_failure(journal: Journal, at: int) -> None:
    """The learner failed at the entry ``at``."""
    before = read_failure(journal)
    times = before.times + 1 if before is not None and before.at == at else 1
    journal.set_meta("failure", codec.to_json(Failure(at, times)).decode())


def _newest_state(journal: Journal) -> tuple[int, LearnerState] | None:
    for snapshot in journal.snapshots():
        try:
            return snapshot.position, unpack(snapshot.state)
        except NewerSnapshot as error:
            raise StateError(f"a newer camtopod has saved what was learned ({error}): use that one") from None
        except SnapshotError as error:
            log.error("the snapshot at entry %d cannot be used: %s", snapshot.position, error)
    return None
