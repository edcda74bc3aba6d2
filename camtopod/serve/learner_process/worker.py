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
from typing import Any

import msgspec

from camtopod import codec
from camtopod.admin import Command, Forget, Rename, Reset, Rewind, TakeBack
from camtopod.learn.declarations import forgotten, taken_back
from camtopod.learn.learner import Learner
from camtopod.learn.renaming import rename
from camtopod.learn.rewinding import rewind
from camtopod.learn.settings import Settings
from camtopod.learn.snapshot import LearnerState, NewerSnapshot, SnapshotError, pack, unpack
from camtopod.predict import PreparedVersion, outside_rates
from camtopod.records import LearnerCounts, Topology
from camtopod.serve.learner_process.messages import (
    STATE,
    Answer,
    Begin,
    Input,
    LearnBatch,
    LearnProgress,
    Load,
    Loaded,
    NewVersion,
    Question,
)
from camtopod.serve.storage import StoredVersion, read_command
from camtopod.topology import alarms_follow, make_delta, map_of, version_model

NICENESS = 5
"""Added to the daemon's niceness: when all cores are busy, predictions and acks precede fits.

It is small enough that versions are still made on a machine with other work to do.
"""


SNAPSHOT_ENTRIES = 20_000
"""Number of entries after which the learner's state is saved; also after every version."""


class Worker:
    """Answers the daemon's questions.

    entry: shared memory for the number of the entry that is being learned; 0: none; STATE.
    learner: the class of the learner.
    """

    def __init__(self, entry: c_longlong, learner: type[Learner]) -> None:
        self._entry = entry
        self._learner_class = learner
        self._saved_state: LearnerState | None = None
        self._learner: Learner
        self._newest: Topology | None = None
        self._since_saved = 0

    def answer(self, question: Question) -> Answer:
        """Answer a question."""
        self._entry.value = STATE
        match question:
            case Load(state):
                answer: Answer = self._load(state)
            case Begin():
                self._begin(question)
                answer = self._progress(0, event_time=self._learner.event_time())
            case LearnBatch(position, inputs):
                answer = self._learn(position, inputs)
        self._entry.value = 0
        return answer

    def _load(self, content: bytes) -> Loaded:
        """Unpack a state and keep it for `Begin`."""
        try:
            self._saved_state = state = unpack(content)
        except SnapshotError as error:
            return Loaded(reason=str(error), newer=isinstance(error, NewerSnapshot))
        version = 0 if state.topology is None else state.topology.version
        return Loaded(state.settings, state.site, state.epoch, version)

    def _begin(self, begin: Begin) -> None:
        """Make the learner, with the loaded state if the daemon wants it."""
        self._learner = self._new_learner(begin.settings, begin.site, begin.epoch)
        if begin.load and (state := self._saved_state) is not None:
            self._learner.load(state)
            if state.epoch != begin.epoch:
                self._learner.begin_epoch(begin.epoch)
        if self._learner.state.names is None:
            self._learner.state.names = dict(begin.names)
        self._saved_state = None
        self._newest = self._learner.topology

        # Fits yield the processor to the daemon; not before, as the start is waited for.
        with contextlib.suppress(PermissionError):  # if the unit forbids changes of priorities
            os.nice(NICENESS)

    def _new_learner(self, settings: Settings, site: str, epoch: str) -> Learner:
        """Return a new learner, which stops behind each version, as that has to be stored."""
        learner = self._learner_class(settings, site, epoch)
        learner.pauses = True
        return learner

    def _change(self, change: Callable[[LearnerState], LearnerState]) -> None:
        """Continue with a changed state; only a new learner can load one."""
        learner = self._learner
        self._learner = self._new_learner(learner.settings, learner.site, learner.epoch)
        self._learner.load(change(learner.save()))

    def _rewind(self, command: Rewind) -> None:
        """Drop events after a time, and begin an epoch unless a later one has begun already."""
        self._change(lambda state: rewind(state, command.to))
        if command.epoch > self._learner.epoch:
            self._newest = None
            self._learner.begin_epoch(command.epoch)
            self._learner.make_version()

    def _reset(self, command: Reset) -> None:
        """Begin with a new learner, in a new epoch unless a later one has begun already."""
        epoch = self._learner.epoch
        after = self._learner.topology
        if command.epoch > epoch:
            epoch = command.epoch
            after = None
            self._newest = None
        fresh = self._new_learner(self._learner.settings, self._learner.site, epoch)
        fresh.begin_empty(command.t, after)
        self._learner = fresh

    @property
    def _names(self) -> dict[str, str]:
        return self._learner.state.names or {}

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
            case Forget(camera, until):
                if until is None:
                    self._learner.state.names = forgotten(self._names, camera)
                if self._learner.erase({camera}):
                    self._learner.make_version()
            case TakeBack(camera):
                self._learner.state.names = taken_back(self._names, camera)

    def _learn(self, position: int, inputs: list[Input]) -> LearnProgress:
        """Learn entries of the journal, up to one that makes a version."""
        unreadable = 0
        if not inputs and self._learner.topology is None:
            self._learner.make_version()
        self._entry.value = position
        self._learner.resume()
        versions = self._take_versions()
        for kind, raw in [] if versions else inputs:
            self._entry.value = position + 1
            try:
                match kind:
                    case "event":
                        self._learner.receive(codec.event_from_bytes(raw))
                    case "advance":
                        self._learner.advance(float(raw))
                    case "waits":
                        self._learner.wait_for(codec.read(set[str], raw))
                    case "command" | "correction":
                        self._apply(read_command(raw))
            except codec.Rejected:  # another program accepted it
                unreadable += 1
            position += 1
            self._since_saved += 1
            if versions := self._take_versions():
                break

        # Save the state with the versions.
        state = None
        if versions or self._since_saved >= SNAPSHOT_ENTRIES:
            state = pack(self._learner.save())
            self._since_saved = 0
        return self._progress(position, unreadable=unreadable, versions=versions, state=state)

    def _progress(self, position: int, **fields: Any) -> LearnProgress:
        """Return the progress."""
        learner = self._learner
        counts = msgspec.convert(learner.statistics(), LearnerCounts)
        return LearnProgress(
            position, learner.next_deadline(), counts, learner.epoch, learner.is_paused, **fields
        )

    def _take_versions(self) -> list[NewVersion]:
        """Return the versions of a step."""
        versions = []
        for topology in self._learner.updates():
            if topology.epoch != self._learner.epoch:
                continue  # made in the same step as the one that ended its epoch
            delta = None
            if self._newest is not None and alarms_follow(self._newest, topology):
                delta = codec.to_msgpack(make_delta(self._newest, topology))
            self._newest = topology
            record = StoredVersion(
                topology.epoch, topology.version, topology.digest, codec.to_json(topology)
            )
            parts = codec.to_msgpack(map_of(topology)), codec.to_msgpack(version_model(topology))
            outside = outside_rates(PreparedVersion(topology)).tolist()
            versions.append(NewVersion(record, *parts, outside, delta))
        return versions


def main(pipe: Connection, entry: c_longlong, learner: type[Learner] = Learner) -> None:
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
    worker = Worker(entry, learner)
    try:
        while True:
            pipe.send(worker.answer(questions.get()))
    except BrokenPipeError:  # the daemon has ended
        os._exit(0)
