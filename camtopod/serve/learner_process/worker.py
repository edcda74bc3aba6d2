"""The learner's process: it answers the daemon's questions, so that refits do not hold its GIL.

`camtopod.serve.learner_process.process` starts it and asks over a pipe. It neither stores nor
publishes anything. It ends at once when the daemon ends. An exception ends it too: the traceback
goes to standard error, and the daemon reads in shared memory at which entry of the journal it was.
"""

from __future__ import annotations

import contextlib
import faulthandler
import gc
import os
import queue
import signal
import threading
from collections.abc import Callable
from ctypes import c_longlong
from multiprocessing.connection import Connection

from camtopod import codec
from camtopod.admin import Command, Forget, Rename, Reset, Rewind, TakeBack
from camtopod.learn.learner import Learner
from camtopod.learn.renaming import rename
from camtopod.learn.rewinding import rewind
from camtopod.learn.snapshot import LearnerState, NewerSnapshot, SnapshotError, pack, unpack
from camtopod.records import Topology
from camtopod.serve.learner_process.messages import (
    Answer,
    Begin,
    Input,
    LearnBatch,
    LearnProgress,
    Load,
    Loaded,
    NewEpoch,
    NewVersion,
    Question,
    Save,
    Saved,
    VersionMismatch,
)
from camtopod.serve.storage import read_command
from camtopod.topology import alarms_follow, make_delta

NICENESS = 5
"""Added to the daemon's niceness: when all cores are busy, predictions and acks precede fits.

It is small enough that versions are still made on a machine with other work to do.
"""


class Worker:
    """Answers the daemon's questions.

    questions: what the daemon asks.
    entry: shared memory for the number of the entry that is being learned; 0: none.
    hurry: shared memory, not 0 if the step is to end after the present entry.
    learner: the class of the learner.
    """

    def __init__(
        self,
        questions: queue.SimpleQueue[Question],
        pipe: Connection,
        entry: c_longlong,
        hurry: c_longlong,
        learner: type[Learner],
    ) -> None:
        self._questions = questions
        self._pipe = pipe
        self._entry = entry
        self._hurry = hurry
        self._learner_class = learner
        self._loaded: LearnerState | None = None
        self._learner: Learner
        self._newest: Topology | None = None

    def work(self) -> None:
        """Answer questions for ever."""
        while True:
            question = self._questions.get()
            match question:
                case Load(state):
                    self._send(self._load(state))
                case Begin():
                    self._begin(question)
                    progress = self._progress(0, 0)
                    progress.event_time = self._learner.event_time()
                    self._send(progress)
                case LearnBatch(position, inputs):
                    self._send(self._learn(position, inputs))
                case Save():
                    self._send(Saved(pack(self._learner.save())))
                case NewEpoch():
                    raise ValueError("a new epoch was sent without a version mismatch")

    def _load(self, packed: bytes) -> Loaded:
        """Unpack a state and keep it for `Begin`."""
        try:
            self._loaded = state = unpack(packed)
        except SnapshotError as error:
            return Loaded(reason=str(error), newer=isinstance(error, NewerSnapshot))
        return Loaded(state.settings, state.site)

    def _begin(self, given: Begin) -> None:
        """Make the learner, with the loaded state if the daemon wants it."""
        self._learner = self._learner_class(given.settings, given.site, given.epoch)
        if given.load and (state := self._loaded) is not None:
            self._learner.load(state)
            if state.epoch != given.epoch:
                self._learner.begin_epoch(given.epoch)
        self._loaded = None
        self._stored = given.stored
        self._enter(given.epoch)
        self._newest = self._learner.topology

        # Fits yield the processor to the daemon; not before, as the start is waited for.
        with contextlib.suppress(PermissionError):  # if the unit forbids changes of priorities
            os.nice(NICENESS)

    def _enter(self, epoch: str) -> None:
        """Begin with the versions of an epoch, some of which may be stored."""
        self._digests = self._stored.pop(epoch, {})
        self._newest_stored = max(self._digests, default=0)
        self._newest = None

    def _begin_epoch(self, epoch: str) -> None:
        """Continue in another epoch."""
        self._enter(epoch)
        self._learner.begin_epoch(epoch)
        self._learner.refresh()

    def _change(self, change: Callable[[LearnerState], LearnerState]) -> None:
        """Continue with a changed state; only a new learner can load one."""
        learner = self._learner
        self._learner = self._learner_class(learner.settings, learner.site, learner.epoch)
        self._learner.load(change(learner.save()))

    def _rewind(self, command: Rewind) -> None:
        """Drop events after a time, and begin an epoch unless a later one has begun already."""
        self._change(lambda state: rewind(state, command.to))
        if command.epoch > self._learner.epoch:
            self._begin_epoch(command.epoch)

    def _reset(self, command: Reset) -> None:
        """Begin with a new learner, in a new epoch unless a later one has begun already."""
        epoch = self._learner.epoch
        after = self._learner.topology
        if command.epoch > epoch:
            epoch = command.epoch
            after = None
            self._enter(epoch)
        fresh = self._learner_class(self._learner.settings, self._learner.site, epoch)
        fresh.begin_empty(command.t, after)
        self._learner = fresh

    def _apply(self, command: Command) -> None:
        """Apply a command."""
        match command:
            case Reset():
                self._reset(command)
            case Rewind():
                self._rewind(command)
            case Rename(old, new):
                self._learner.erase({new})
                self._change(lambda state: rename(state, old, new))
                self._learner.make_version()
            case Forget(camera):
                if self._learner.erase({camera}):
                    self._learner.make_version()
            case TakeBack():
                pass  # only the daemon refuses events

    def _learn(self, position: int, inputs: list[Input]) -> LearnProgress:
        """Learn entries of the journal, or as many as there is time for."""
        unreadable = 0
        if not inputs:
            self._entry.value = position + 1
            self._learner.refresh()
            self._take_versions()
        for kind, raw in inputs:
            self._entry.value = position + 1
            try:
                match kind:
                    case "event":
                        self._learner.receive(codec.event_from_bytes(raw))
                    case "advance":
                        self._learner.advance(float(raw))
                    case "command" | "correction":
                        self._apply(read_command(raw))
            except codec.Rejected:  # another program accepted it
                unreadable += 1

            # Send new versions, and stop if time is short.
            self._take_versions()
            position += 1
            if self._hurry.value:
                break
        self._entry.value = 0
        return self._progress(position, unreadable)

    def _progress(self, position: int, unreadable: int) -> LearnProgress:
        """Return the progress."""
        return LearnProgress(
            position,
            self._learner.next_deadline(),
            self._learner.statistics(),
            unreadable,
            epoch=self._learner.epoch,
        )

    def _take_versions(self) -> None:
        """Send the versions of a step; called before the next step.

        Otherwise learning could continue from a version that differs from the published one, where
        a new epoch has to begin.
        """
        while made := self._learner.updates():
            for topology in made:
                self._send_version(topology)

    def _send_version(self, topology: Topology) -> None:
        """Send a version if it is new.

        A version that is already stored must be the same; one that was stored but is no longer kept
        is passed over.
        """
        if topology.epoch != self._learner.epoch:
            return  # made in the same step as the one that ended its epoch

        # Compare it with the stored one.
        stored = self._digests.pop(topology.version, None)
        if stored is not None and stored != topology.digest:
            self._send(VersionMismatch(topology.version))
            answer = self._questions.get()
            assert isinstance(answer, NewEpoch)
            self._begin_epoch(answer.epoch)
            return

        # Pass over versions from before the start.
        before = self._newest
        self._newest = topology
        if topology.version <= self._newest_stored:
            return

        # Send a new one.
        delta = None
        if before is not None and alarms_follow(before, topology):
            delta = codec.to_msgpack(make_delta(before, topology))
        self._send(NewVersion(codec.to_json(topology), codec.to_msgpack(topology), delta))

    def _send(self, answer: Answer) -> None:
        self._pipe.send(answer)


def main(
    pipe: Connection, entry: c_longlong, hurry: c_longlong, learner: type[Learner] = Learner
) -> None:
    """Learn until the daemon ends; never returns."""
    # A terminal or systemd sends these to the whole group, but the daemon handles them.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    faulthandler.enable()
    gc.freeze()  # imported modules are never garbage
    questions: queue.SimpleQueue[Question] = queue.SimpleQueue()

    def listen() -> None:
        """Read questions in a thread, which notices the daemon's end even during a fit."""
        try:
            while True:
                questions.put(pipe.recv())
        except (EOFError, OSError):
            os._exit(0)

    threading.Thread(target=listen, name="listen", daemon=True).start()
    try:
        Worker(questions, pipe, entry, hurry, learner).work()
    except BrokenPipeError:  # the daemon has ended
        os._exit(0)
