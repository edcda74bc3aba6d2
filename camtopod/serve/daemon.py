"""The daemon: events from the bus to the learner; topology, predictions and status to the bus.

Theory of operation. Besides the bus's own there are these threads:

- *receive* hears events, predicts from exits with the newest version, and decides what is stored;
- *store* owns the journal: it commits events, queues them for the learner, answers the grabbers'
  requests, and stores each version before it is published;
- *learn* passes committed events, in the journal's order, to the learner, which runs in its own
  process;
- *status* publishes the status.

All queues between them are bounded; when one is full, events stay in the grabbers' spools.
"""

from __future__ import annotations

import contextlib
import logging
import sqlite3
import threading
import time
from collections.abc import Callable

from msgspec.structs import replace

from camtopod.admin import Reset, Rewind
from camtopod.config import Config
from camtopod.keys.rules import STATUS
from camtopod.records import CameraFigures, DaemonStatus, EventCounts, Match, Prediction, Topology
from camtopod.redact import redact
from camtopod.serve.admin_queries import Done, command_of
from camtopod.serve.bus import Bus, OtherDaemons, QueryError, open_daemon_session
from camtopod.serve.ingest import (
    Backlogs,
    Cameras,
    CommandRefused,
    EventClock,
    Intake,
    Names,
    Numbers,
    execute,
    present_names,
    read_names,
)
from camtopod.serve.learner_process import (
    LearnerEnded,
    LearnerFeeder,
    LearnerProcess,
    LearnProgress,
    Recovered,
    event_time,
    note_failure,
    recent_events,
    recover,
)
from camtopod.serve.live_predictions import Live
from camtopod.serve.runtime import LEARN_SECONDS, STALL_SECONDS, Beat, Progress, clock as clocks
from camtopod.serve.storage import Journal, JournalWriter, StateError
from camtopod.serve.versions import PARTS, Versions, schema_of

log = logging.getLogger(__name__)

STOP_SECONDS = 4.0
"""Time that `stop` waits for the threads; what they have not done by then is in the journal."""
RETURN_SECONDS = 10.0
"""Time after a start in which grabbers come back; who has not come by then is said to be away."""
NAMES_SECONDS = 600.0
"""Time after a start after which names of [topology] that no camera has are warned of."""
STATUS_ALARMS = 10
"""Number of newest alarms in ``status/daemon``; the topology lists more."""
STATUS_PAIRS = 100
"""Number of pairs of cameras in ``between`` of ``status/daemon``; a query may ask for all."""


class Daemon:
    """The daemon of `camtopod run`; it can also be used inside another process.

    Raises `BusError` or `StateError`.
    """

    def __init__(self, config: Config, clock: clocks.Clock = clocks.wall) -> None:
        self._config = config
        self._clock = clock
        self._steady = clocks.steady_clock_for(clock)
        self._bus: Bus | None = None
        self._stopping = threading.Event()
        self._failure = threading.Event()
        self._threads: list[threading.Thread] = []
        self._process: LearnerProcess | None = None
        self.started = False
        """True when `start` has succeeded."""
        self.progress = Progress()
        """Progress of the daemon's loops and, before they run, of the start."""

    @property
    def endpoint(self) -> str:
        """Endpoint at which other programs reach the bus; valid after `start`."""
        return self.bus.endpoint

    @property
    def bus(self) -> Bus:
        """The session in use; valid after `start`."""
        assert self._bus is not None, "the daemon has not been started"
        return self._bus

    @property
    def topology(self) -> Topology | None:
        """The newest version, without its model and weak links; valid after `start`."""
        return self._versions.newest

    @property
    def learner_pid(self) -> int:
        """Process id of the learner; valid after `start`."""
        assert self._process is not None, "the daemon has not been started"
        return self._process.pid

    @property
    def epoch(self) -> str:
        """Epoch of the next version; valid after `start`."""
        return self._learning.progress.epoch

    def start(self, cancel: threading.Event | None = None) -> bool:
        """Read the journal, join the bus and start the threads, then return: ready to receive.

        Return False if ``cancel`` was set before that was done.
        """
        cancellation = cancel or self._stopping
        self.progress.watch("start", LEARN_SECONDS)
        config = self._config
        self._journal = Journal(config.state_directory, config.keep)

        # Recover the learner, join the bus and build the parts; undo everything on failure.
        with contextlib.ExitStack() as undo:
            undo.callback(self.stop)
            try:
                epochs = [self._journal.meta(key) for key in ("epoch", "epoch before")]
                self._last_epoch = max(filter(None, epochs), default="")
                # The process loads its libraries while the bus is joined.
                self._process = process = LearnerProcess()
                self._bus = open_daemon_session(config)
                recovery = recover(
                    self._journal,
                    process,
                    config.learner,
                    config.site.name,
                    self._new_epoch,
                    present_names(read_names(self._journal)),
                )
                self._build(self._bus, recovery, process)
                self._rivals = OtherDaemons(self._bus, clocks.ulid(self._clock()))
                self._rivals.require_none(config.bus.connect_seconds, cancellation)
                if cancellation.is_set():
                    return False
                self._started_at = self._steady()
                self._join_bus(self._bus)
            except LearnerEnded as death:
                note_failure(self._journal, death.at)
                raise StateError(f"{death}; start the daemon again") from None
            except sqlite3.Error as error:
                raise StateError(
                    f"cannot read the journal in {config.state_directory}: {error};"
                    " the file was not modified"
                ) from None
            undo.pop_all()

        # Publish the newest version again, and start the threads.
        if self.topology is not None:
            self._versions.publish_newest()
        status_seconds = config.limits.status_seconds + STALL_SECONDS
        self._start_thread("receive", self._intake.work, STALL_SECONDS)
        self._start_thread("store", self._intake.store, STALL_SECONDS)
        self._start_thread("learn", self._learning.work, LEARN_SECONDS)
        self._start_thread("status", self._publish_status, status_seconds)
        self.progress.unwatch("start")
        self.started = True
        log.info(
            "site %s, epoch %s: ready at %s", self._config.site.name, self.epoch, self._bus.endpoint
        )
        return True

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until a thread has failed (return True) or the time is over (return False)."""
        return self._failure.wait(seconds)

    def stop(self) -> None:
        """Stop cleanly, within about `STOP_SECONDS`; may be called twice."""
        if self._stopping.is_set():
            return
        self._stopping.set()
        deadline = time.monotonic() + STOP_SECONDS
        for thread in self._threads:
            thread.join(max(0.0, deadline - time.monotonic()))
        if self._bus is not None:
            self._bus.close()

        # A thread that still runs keeps its files.
        if self._process is not None:
            self._process.close()
        if not any(thread.name == "store" and thread.is_alive() for thread in self._threads):
            self._journal.close()

    def failing(self) -> list[str]:
        """Return the reasons for a restart; empty if all loops make progress."""
        reasons = self.progress.stalled()
        if self._failure.is_set():
            reasons.insert(0, "a part of the daemon has failed")
        return reasons

    def unready(self) -> list[str]:
        """Return the reasons not to rely on the daemon now; a restart may not remove them."""
        if self._stopping.is_set():
            return ["the daemon is stopping"]
        if not self.started or self._bus is None:
            return ["the daemon is starting"]
        reasons = list(filter(None, [self._reason]))
        if self._learning.replaying:
            reasons.append(
                f"{self._learning.replaying} entries of the journal are still to be learned"
            )
        if not self._config.listens and not self._bus.connected:
            reasons.append(f"the bus at {self._bus.endpoint} is not reached")
        return [redact(reason) for reason in reasons] + self.failing()

    def status(self, pairs_max: int | None = STATUS_PAIRS) -> DaemonStatus:
        """Return the contents of ``status/daemon``: state, reason and counters.

        pairs_max: number of pairs of cameras in ``between``; None for all.
        """
        intake = self._intake
        learning = self._learning
        figures = self._figures()

        topology = self.topology
        reason = (
            self._reason
            or self._rivals.reason
            or "; ".join(self.failing())
            or intake.cameras.fast_clocks_reason(self._config.limits.future_seconds_max)
        )
        status = DaemonStatus(
            state="degraded" if reason else "running",
            reason=redact(reason),
            site=self._config.site.name,
            epoch=self.epoch,
            t=self._clock(),
            status_seconds=self._config.limits.status_seconds,
            events=EventCounts(**intake.counts, lost=intake.numbers.loss, waiting=learning.waiting),
            rejects=dict(intake.rejects.counts),
            reject_samples=intake.rejects.samples(),
            dropped=dict(intake.inbox.dropped),
            learner=learning.progress.statistics,
            catching_up=learning.catching_up(min(self._clock(), self._live.newest_t)),
            predictions=self._live.counts["predictions"],
            matches_skipped=self._live.counts["matches_skipped"],
            questions_refused=self._live.counts["questions_refused"],
            between=self._live.between(pairs_max),
            names=intake.names.status(),
            journal=replace(self._journal.status(), damaged=self._learning.damage_count),
            cameras=figures,
            warnings=self._warnings(),
        )
        if topology is None:
            return status
        return replace(
            status,
            epoch=topology.epoch,
            version=topology.version,
            score=topology.score,
            alarms=(topology.alarms or [])[-STATUS_ALARMS:],
        )

    def _warnings(self) -> list[str]:
        """Return what somebody should look at, a sentence each."""
        ids = {camera.id for camera in self.topology.cameras} if self.topology else set()
        early = self._steady() - self._started_at < NAMES_SECONDS
        missing = [] if early else self._intake.missing(self._config.topology, ids)
        return [*self._intake.too_old.values(), *missing]

    def _figures(self) -> dict[str, CameraFigures]:
        """Return the status by camera: of all that are known, once it is known who is there."""
        intake = self._intake
        present = intake.names.present
        cameras = intake.cameras.all()
        ids = {camera.id for camera in self.topology.cameras} if self.topology else set()
        if intake.names.state.since is None:
            ids.update(camera.name for camera in cameras)

        # Names may be old ones. After a start the grabbers come back one by one.
        alive, ids = present(intake.alive.copy()), present(ids)
        if self._steady() - self._started_at < RETURN_SECONDS:
            alive |= present(camera.name for camera in cameras if camera.spooled)
            ids &= alive
        return intake.cameras.status(alive, ids)

    @property
    def _reason(self) -> str:
        """Why events are not stored, or not learned, at the moment; "" if they are."""
        intake = self._intake
        return (
            intake.writer.reason
            or intake.event_clock.reason(self._clock())
            or intake.cameras.refused_reason(self._steady())
            or intake.cameras.behind_reason(self._clock(), self._steady())
        )

    def __enter__(self) -> Daemon:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _new_epoch(self) -> str:
        """Begin an epoch and store its name."""
        self._last_epoch = clocks.ulid(self._clock(), after=self._last_epoch)
        self._journal.set_meta("epoch", self._last_epoch)
        return self._last_epoch

    def _reset(self) -> Reset:
        """Return the whole command that begins the site anew; its epoch is stored with it."""
        now = self._clock()
        return Reset(now, self._last_epoch, clocks.ulid(now, after=self._last_epoch))

    def _begun(self, epoch: str) -> None:
        """Note that a command has begun an epoch."""
        self._live.forget()
        self._last_epoch = epoch

    def _rewind(self, to: float) -> Rewind:
        """Return the command that takes event time back to ``to`` (Unix seconds)."""
        before = self._last_epoch
        self._begun(clocks.ulid(self._clock(), after=before))
        log.error(
            "this machine's clock was set back: what was learned of later events is dropped, and"
            " event time continues from the clock, in epoch %s",
            self._last_epoch,
        )
        return Rewind(to, before, self._last_epoch)

    def _build(self, bus: Bus, recovery: Recovered, process: LearnerProcess) -> None:
        """Create the parts from the recovered state and connect them."""
        limits = self._config.limits

        # Predictions, and the versions that they are made from.
        def publish(answer: Prediction | Match) -> None:
            kind = "match" if isinstance(answer, Match) else "prediction"
            bus.publish(f"{kind}/{answer.camera}", answer, kind)

        self._live = Live(publish, self._clock)
        self._versions = Versions(bus, self._journal, self._live, self._config.site.walks)

        # Event time as the learner knows it; the newest events may be newer than the snapshot.
        recent = recent_events(self._journal)
        lateness = self._config.learn.lateness_seconds
        learner_time = event_time(self._journal, recovery, self._config.learn, recent)

        # Receiving and storing.
        numbers = Numbers(self._journal.numbers())
        cameras = Cameras(limits.cameras_max)
        wall, now = self._clock(), self._steady()
        for camera in numbers.cameras[-limits.cameras_max :]:
            cameras.register(camera, now)
        event_clock = EventClock(
            learner_time, limits.future_seconds_max, limits.settle_seconds, wall, now
        )
        self._intake = Intake(
            numbers,
            cameras,
            Names(read_names(self._journal), self._clock),
            Backlogs(lateness, event_clock, now),
            event_clock,
            JournalWriter(self._journal, self._clock),
            limits,
            hear=self._live.hear,
            match=self._live.match,
            learn=lambda _: self._learning.note_stored(),
            rewind=self._rewind,
            clock=self._clock,
            steady=self._steady,
        )

        # Learning, and what predictions remember.
        self._on_progress(recovery.progress)
        self._learning = LearnerFeeder(recovery, process, self._journal, self._on_progress)
        erased = self._intake.names.state.erased
        self._live.remember([event for n, event in recent if n > erased.get(event.camera, 0)])
        self._forget_cameras()

    def _forget_cameras(self) -> None:
        """Let predictions and earlier versions forget cameras, too."""
        self._versions.erased = self._intake.names.state.erased
        self._live.forget_cameras(self._intake.names.state.forgotten)

    def _join_bus(self, bus: Bus) -> None:
        """Answer queries and subscribe to events; then other programs may see the daemon."""
        for key in PARTS:
            bus.answer_queries(key, self._versions.answer, schema_of(key))
        bus.answer_queries("admin/*", self._administer, "done")
        bus.answer_queries("predict/*", self._live.answer, "prediction")
        bus.answer_queries("recent", self._live.recent, "recent")
        bus.answer_queries(
            STATUS,
            lambda _, query: self.status(None if query.get("pairs") == "all" else STATUS_PAIRS),
            "status",
        )
        bus.subscribe("event/*", self._intake.inbox.on_event)
        bus.watch_alive("grabber", self._intake.on_alive)
        bus.answer_requests("store/*", self._intake.inbox.on_request)
        self._rivals.appear()

    def _administer(self, key: str, parameters: dict[str, str]) -> Done:
        """Execute the operator's command of a query. Raises `QueryError`."""
        try:
            command = command_of(key, parameters)
            effect = execute(self._intake, command, self.topology, self._reset, self._begun)
            self._forget_cameras()
            return Done(effect)
        except CommandRefused as error:
            raise QueryError(str(error)) from None
        except (sqlite3.Error, StateError) as error:
            raise QueryError(f"the journal cannot be written: {error}") from None

    def _on_progress(self, progress: LearnProgress) -> None:
        """Take note of what the learner waits for, and have stored what it has made."""
        self._intake.event_clock.deadline = progress.deadline
        if progress.state is not None:
            self._intake.writer.on_learned(self._versions.learned(progress, progress.state))

    def _publish_status(self, stopping: threading.Event, beat: Beat) -> None:
        """Publish the status at intervals until the daemon stops."""
        while not stopping.wait(self._config.limits.status_seconds):
            self.bus.publish(STATUS, self.status(), "status")
            self._intake.cameras.log_behind(self._clock(), self._steady())
            beat()

    def _start_thread(
        self, name: str, work: Callable[[threading.Event, Beat], None], seconds_max: float
    ) -> None:
        """Run a loop in a thread; it has to beat at least every ``seconds_max``."""
        mark = self.progress.watch(name, seconds_max)

        def guarded() -> None:
            with contextlib.ExitStack() as undo:
                undo.callback(self._failure.set)  # the traceback goes to standard error by itself
                work(self._stopping, mark.beat)
                undo.pop_all()

        thread = threading.Thread(target=guarded, name=name, daemon=True)
        self._threads.append(thread)
        thread.start()
