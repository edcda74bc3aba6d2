"""Recover the learner at a start: from the newest usable snapshot, else from the oldest entry.

An epoch is a sequence of versions that results from one unbroken history of events, settings and
program. When that can no longer be guaranteed a new epoch begins, with everything that is known.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable
from typing import NamedTuple

import msgspec

from camtopod import codec
from camtopod.admin import Command, Forget, Rename
from camtopod.learn import Settings
from camtopod.records import Event, Topology
from camtopod.serve.learner_process.messages import (
    Begin,
    LearnProgress,
    Load,
    Loaded,
    Show,
    Shown,
    Unusable,
)
from camtopod.serve.learner_process.process import LearnerProcess
from camtopod.serve.storage import (
    Journal,
    StateError,
    camera_to_leave_out,
    leave_out,
    read_command,
    read_corrections,
)

log = logging.getLogger(__name__)

FAILURES_MAX = 2
"""Number of failures of the learner at one entry after which something has to be given up.

First the events of the camera that has sent most are left out; if that does not help, the learner
begins anew after the entry.
"""
KILLS_MAX = 5
"""Number of kills (SIGKILL) of the process at one entry that has the same consequence.

A person may kill it once or twice; only the system kills it always at the same entry, as there is
not enough memory for what has been learned.
"""
RECENT_EVENTS, RECENT_SECONDS = 4_000, 600.0
"""Most events, and most seconds before the newest one, that predictions remember at a start."""


class Failure(msgspec.Struct):
    """A failure of the learner: ``times`` failures and ``kills`` kills at the entry ``at``."""

    at: int
    times: int
    kills: int = 0
    out_of_memory: int = 0
    """How many of ``times`` were for lack of memory."""

    @property
    def is_out_of_memory(self) -> bool:
        """True if there is too much to learn at once, not something that cannot be learned.

        Kills count as lack of memory: it is the system that kills.
        """
        return self.kills + self.out_of_memory > self.times - self.out_of_memory

    @property
    def is_hopeless(self) -> bool:
        """True if something of what was learned has to be given up."""
        return self.times >= FAILURES_MAX or self.kills >= KILLS_MAX


class Recovered(NamedTuple):
    """State of the learner at the start.

    position: number of the last entry of the journal that it has learned.
    left_out: for some cameras, the entry up to which their events are not learned.
    """

    position: int
    epoch: str
    taught: LearnProgress
    left_out: dict[str, int] = {}  # noqa: RUF012 -- never changed


def recover(
    journal: Journal,
    process: LearnerProcess,
    settings: Settings,
    site: str,
    new_epoch: Callable[[], str],
    now: float = 0.0,
) -> Recovered:
    """Load the learner into ``process`` and return its state. Raises `StateError`.

    new_epoch: begins an epoch and stores its name.
    now: Unix seconds.
    """

    def begin(position: int, epoch: str, load: bool = False) -> Recovered:
        before, left_out, forgotten = read_corrections(journal, position, epoch)
        epoch = before or epoch
        taught = process.ask(Begin(settings, site, epoch, journal.versions(epoch), load, forgotten))
        assert isinstance(taught, LearnProgress)
        return Recovered(position, epoch, taught, left_out)

    # A new state begins an epoch.
    epoch = journal.meta("epoch")
    if epoch is None:
        epoch = new_epoch()

    # After too many failures at one entry, leave out the events of a camera, or begin behind it.
    failure, found = read_failure(journal), _newest_state(journal, process)
    beyond = 0 if found is None else found[0]
    if failure is not None and failure.is_hopeless and beyond < failure.at:
        ended, epoch = epoch, new_epoch()
        camera = camera_to_leave_out(journal, beyond, failure.at, most=failure.is_out_of_memory)
        if camera is not None:
            journal.commit(
                [leave_out(camera, ended, epoch, forget=failure.is_out_of_memory)], now=now
            )
            journal.set_meta("failure", codec.to_json(Failure(0, 0)).decode())
            log.error(
                "the learner has failed %d times at entry %d of the journal and was killed there"
                " %d times%s: the events of camera %s since entry %d are left out, in epoch %s;"
                " they are still in the journal; please report this",
                failure.times,
                failure.at,
                failure.kills,
                " as memory ran out" if failure.is_out_of_memory else "",
                camera,
                beyond,
                epoch,
            )
            return begin(beyond, epoch, load=found is not None)
        log.error(
            "the learner has failed %d times at entry %d of the journal and was killed there"
            " %d times: it begins anew after that entry, in epoch %s; the entries up to there are"
            " still in the journal; please report this",
            failure.times,
            failure.at,
            failure.kills,
            epoch,
        )
        return begin(failure.at, epoch)

    # Without a snapshot, learn all entries.
    if found is None:
        if journal.first() != 1 and journal.versions(epoch):
            epoch = new_epoch()
            log.warning(
                "the oldest events are no longer kept and there is no snapshot: epoch %s begins",
                epoch,
            )
        return begin(max(journal.first() - 1, 0), epoch)

    # With a snapshot, learn the entries after it.
    position, state = found
    if (state.settings, state.site) != (settings, site):
        epoch = new_epoch()
        log.warning(
            "settings of the learner have changed: epoch %s begins with what has been learned",
            epoch,
        )
    return begin(position, epoch, load=True)


def newest_topology(journal: Journal, process: LearnerProcess) -> Topology | None:
    """Return the version published last, of any epoch; it is valid until there is another."""
    content = journal.newest_version()
    if content is not None:
        try:
            return codec.read(Topology, content)
        except codec.Rejected as error:
            log.error(
                "the newest version in the journal cannot be read: %s; the learner's is used",
                error,
            )
    shown = process.ask(Show())
    assert isinstance(shown, Shown)
    return None if shown.packed is None else codec.read(Topology, shown.packed, pack=True)


def recent_events(journal: Journal) -> list[Event]:
    """Return the newest events of the journal, for predictions to remember.

    They are without those of forgotten cameras and from before a reset.
    """
    events: list[Event] = []
    for _, entry in journal.entries(after=max(0, len(journal) - RECENT_EVENTS)):
        if entry is None:
            continue
        with contextlib.suppress(codec.Rejected):  # accepted by another version
            if entry.kind == "event":
                events.append(codec.event_from_bytes(entry.raw))
            elif entry.kind == "reset":
                events = []
            elif entry.kind == "command":
                events = _after(read_command(entry), events)
    newest = max((event.t for event in events), default=0.0)
    return [event for event in events if event.t > newest - RECENT_SECONDS]


def _after(command: Command, events: list[Event]) -> list[Event]:
    """Return events as they are known after a command."""
    match command:
        case Forget(camera):
            return [event for event in events if event.camera != camera]
        case Rename(old, new):
            return [
                msgspec.structs.replace(event, camera=new) if event.camera == old else event
                for event in events
            ]
        case _:
            return events


def read_failure(journal: Journal) -> Failure | None:
    """Return the last failure of the learner, which may be past that entry by now."""
    kept = journal.meta("failure")
    return None if kept is None else codec.read(Failure, kept.encode())


def note_failure(
    journal: Journal, at: int, killed: bool = False, out_of_memory: bool = False
) -> None:
    """Note that the learner failed at the entry ``at``, or was ``killed`` there."""
    failure = read_failure(journal)
    if failure is None or failure.at != at:
        failure = Failure(at, 0)
    if killed:
        failure.kills += 1
    else:
        failure.times += 1
        failure.out_of_memory += out_of_memory
    journal.set_meta("failure", codec.to_json(failure).decode())


def _newest_state(journal: Journal, process: LearnerProcess) -> tuple[int, Loaded] | None:
    """Return the newest snapshot that can be used, with its position; None if there is none.

    ``process`` has loaded the state that is returned. The position is the number of the last entry
    of the journal that the state has learned.

    Snapshots are tried from the newest on. One that cannot be read is logged, and the one before it
    is tried; one of a newer program raises `StateError`.
    """
    for snapshot in journal.snapshots():
        answer = process.ask(Load(snapshot.state))
        if isinstance(answer, Loaded):
            return snapshot.position, answer

        # It cannot be used: try the one before, unless the program is too old.
        assert isinstance(answer, Unusable)
        if answer.newer:
            raise StateError(
                f"the snapshot was saved by a newer camtopod ({answer.reason}): use that version"
            )
        log.error("the snapshot at entry %d cannot be used: %s", snapshot.position, answer.reason)
    return None
