"""Where the learner goes on after a start: from its newest snapshot that can be read, else from the
oldest event kept.

An epoch is a line of versions that one unbroken history of events, settings and program leads to.
Where that cannot be promised any more a new one begins, with everything that is known.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable
from typing import NamedTuple

import msgspec

from camtopod import codec
from camtopod.learn import Settings
from camtopod.records import Event, Topology
from camtopod.serve.learner_process.messages import (
    Begin,
    Load,
    Loaded,
    Portion,
    Show,
    Shown,
    Taught,
    Unusable,
)
from camtopod.serve.learner_process.process import LearnerProcess
from camtopod.serve.storage import Journal, StateError, corrections, leave_out, offender

log = logging.getLogger(__name__)

FAILURES_MAX = 2
"""When the learner has failed so often at one and the same entry, the events of the camera that has
sent most are left out, or, if that is of no use, it begins anew behind the entry ..."""
KILLS_MAX = 5
"""... and so when its process was killed (SIGKILL) there so often. Who kills it once or twice is
somebody outside; who always does it at the same entry is the system, as there is not the memory for
what has been learned."""
RECENT_EVENTS, RECENT_SECONDS = 4_000, 600.0
"""At most so many events of the last minutes before the start, which predictions remember."""


class Failure(msgspec.Struct):
    """The learner failed ``times`` times at the entry ``at``, and ``kills`` times it was killed
    there.
    """

    at: int
    times: int
    kills: int = 0
    out_of_memory: int = 0
    """How many of the times memory had run out."""

    @property
    def of_memory(self) -> bool:
        """Whether there is too much to learn at once, not something that cannot be learned. Who
        kills is the system.
        """
        return self.kills + self.out_of_memory > self.times - self.out_of_memory

    @property
    def hopeless(self) -> bool:
        """Whether to give up what was learned."""
        return self.times >= FAILURES_MAX or self.kills >= KILLS_MAX


class Recovered(NamedTuple):
    """The learner has learned the journal's entries up to ``position``, and is as it says.
    ``left_out``: by camera the entry up to which its events are left out of what is still to be
    learned.
    """

    position: int
    epoch: str
    taught: Taught
    left_out: dict[str, int] = {}  # noqa: RUF012 -- never changed


def recover(
    journal: Journal,
    process: LearnerProcess,
    settings: Settings,
    site: str,
    new_epoch: Callable[[], str],
    portion: Portion | None = None,
    now: float = 0.0,
) -> Recovered:
    """The learner to go on with is in ``process`` then. ``new_epoch`` begins one and stores its
    name; ``now``: Unix seconds. Raises `StateError`.
    """

    def begin(position: int, epoch: str, load: bool = False) -> Recovered:
        before, left_out, forgotten = corrections(journal, position, epoch)
        epoch = before or epoch
        taught = process.ask(
            Begin(settings, site, epoch, journal.versions(epoch), load, portion, forgotten)
        )
        assert isinstance(taught, Taught)
        return Recovered(position, epoch, taught, left_out)

    epoch = journal.meta("epoch")
    if epoch is None:
        epoch = new_epoch()
    for damaged in journal.damaged_logs()[-1:]:
        if journal.meta("damaged log") != damaged.name:
            epoch = new_epoch()
            log.warning(
                "what the damaged log had in it may have been published: epoch %s begins", epoch
            )
            journal.set_meta("damaged log", damaged.name)
    failure, found = read_failure(journal), _newest_state(journal, process, portion)
    beyond = 0 if found is None else found[0]
    if failure is not None and failure.hopeless and beyond < failure.at:
        ended, epoch = epoch, new_epoch()
        camera = offender(journal, beyond, failure.at, most=failure.of_memory)
        if camera is not None:
            journal.commit([leave_out(camera, ended, epoch, forget=failure.of_memory)], now=now)
            journal.set_meta("failure", codec.to_json(Failure(0, 0)).decode())
            log.error(
                "the learner has failed %d times at entry %d of the journal and was killed there %d times%s: what "
                "camera %s has sent since entry %d is left out, in epoch %s; it is still in the journal, please "
                "report this",
                failure.times,
                failure.at,
                failure.kills,
                " as memory ran out" if failure.of_memory else "",
                camera,
                beyond,
                epoch,
            )
            return begin(beyond, epoch, load=found is not None)
        log.error(
            "the learner has failed %d times at entry %d of the journal and was killed there %d times: it begins anew "
            "behind it, in epoch %s; the entries up to there are still in the journal, please report this",
            failure.times,
            failure.at,
            failure.kills,
            epoch,
        )
        return begin(failure.at, epoch)
    if found is None:
        if journal.first() != 1 and journal.versions(epoch):
            epoch = new_epoch()
            log.warning(
                "the oldest events are not kept any more and there is no snapshot: epoch %s begins",
                epoch,
            )
        return begin(max(journal.first() - 1, 0), epoch)
    position, state = found
    if (state.settings, state.site) != (settings, site):
        epoch = new_epoch()
        log.warning(
            "settings of the learner have changed: with what is known, epoch %s begins", epoch
        )
    return begin(position, epoch, load=True)


def newest_topology(journal: Journal, process: LearnerProcess) -> Topology | None:
    """The version that was published last, of whatever epoch; until there is another it still
    holds.
    """
    content = journal.newest_version()
    if content is not None:
        try:
            return codec.read(Topology, content)
        except codec.Rejected as error:
            log.error("the newest version in the journal cannot be read any more: %s", error)
    shown = process.ask(Show())
    assert isinstance(shown, Shown)
    return None if shown.packed is None else codec.read(Topology, shown.packed, pack=True)


def told_by(process: LearnerProcess) -> bytes | None:
    """What the learner of a shard tells the others, as MessagePack."""
    shown = process.ask(Show())
    assert isinstance(shown, Shown)
    return shown.told


def recent_events(journal: Journal) -> list[Event]:
    """The newest events of the journal, for predictions to remember."""
    events = []
    for _, entry in journal.entries(after=max(0, len(journal) - RECENT_EVENTS)):
        if entry is not None and entry.kind == "event":
            with contextlib.suppress(codec.Rejected):  # another program accepted it
                events.append(codec.event_from_bytes(entry.raw))
    newest = max((event.t for event in events), default=0.0)
    return [event for event in events if event.t > newest - RECENT_SECONDS]


def read_failure(journal: Journal) -> Failure | None:
    """Where the learner failed last; it may have got beyond that since."""
    kept = journal.meta("failure")
    return None if kept is None else codec.read(Failure, kept.encode())


def note_failure(
    journal: Journal, at: int, killed: bool = False, out_of_memory: bool = False
) -> None:
    """The learner failed at the entry ``at``, perhaps ``out_of_memory``, or was ``killed``
    there.
    """
    failure = read_failure(journal)
    if failure is None or failure.at != at:
        failure = Failure(at, 0)
    if killed:
        failure.kills += 1
    else:
        failure.times += 1
        failure.out_of_memory += out_of_memory
    journal.set_meta("failure", codec.to_json(failure).decode())


def _newest_state(
    journal: Journal, process: LearnerProcess, portion: Portion | None
) -> tuple[int, Loaded] | None:
    """The newest that can be read, which ``process`` then has ready."""
    for snapshot in journal.snapshots():
        answer = process.ask(Load(snapshot.state, portion is not None))
        if isinstance(answer, Loaded):
            if answer.portion == portion:
                return snapshot.position, answer
            log.warning(
                "the site is dealt out otherwise than before: what the journal has is learned again"
            )
            return None
        assert isinstance(answer, Unusable)
        if answer.newer:
            raise StateError(
                f"a newer camtopod has saved what was learned ({answer.reason}): use that one"
            )
        log.error("the snapshot at entry %d cannot be used: %s", snapshot.position, answer.reason)
    return None
