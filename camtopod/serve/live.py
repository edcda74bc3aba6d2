"""Predictions as objects leave: a path of its own that no refit and no disk holds up."""

from __future__ import annotations

import collections
import threading
import time
from collections.abc import Callable, Sequence

from camtopod import codec
from camtopod.learn.predict import Predictor
from camtopod.records import Event, Prediction, Topology
from camtopod.serve.bus import QueryError
from camtopod.serve.cameras import Received
from camtopod.serve.progress import Beat, no_beat

_TICK_SECONDS = 0.2
EVENTS_MAX = 2_000
"""Waiting to be predicted or taken note of: some tenths of a second, as later predictions help nobody."""
REST_SHARE, REST_SECONDS_MAX = 3.0, 1.0
"""When there is more than can be predicted, so many times as long as a batch took is left to those who store."""


class Live:
    """Feed it events in the order they are stored; run `work` in a thread of its own."""

    def __init__(self, publish: Callable[[Prediction], None]) -> None:
        self._batches: collections.deque[list[Event]] = collections.deque()
        self._waiting = 0
        self._behind = False
        self._come = threading.Condition()
        self._publish = publish
        self._mutex = threading.Lock()
        self._predictor: Predictor | None = None
        self._topology: Topology | None = None
        self.counts = {"predictions": 0, "predictions_skipped": 0, "questions_refused": 0}

    def feed(self, batch: list[Received]) -> None:
        """Events about to be stored. Never blocks: when there are too many, the oldest are skipped."""
        events = [one.event for one in batch if one.event is not None]
        with self._come:
            self._batches.append(events)
            self._waiting += len(events)
            while self._waiting > EVENTS_MAX and len(self._batches) > 1:
                skipped = self._batches.popleft()
                self._waiting -= len(skipped)
                self.counts["predictions_skipped"] += sum(event.kind == "exit" for event in skipped)
                self._behind = True
            self._come.notify()

    def remember(self, events: Sequence[Event]) -> None:
        """Events of before the start, so that the first predictions know what was going on."""
        predictor = self._newest()
        if predictor is not None:
            for event in events:
                predictor.observe(event)

    def use(self, topology: Topology) -> None:
        """Predict from this version on, remembering what was observed. Never blocks."""
        self._topology = topology

    def work(self, stopping: threading.Event, beat: Beat = no_beat) -> None:
        """Predict until ``stopping``."""
        while not stopping.is_set():
            beat()
            with self._come:
                if not self._batches:
                    self._come.wait(_TICK_SECONDS)
                batch = self._batches.popleft() if self._batches else []
                self._waiting -= len(batch)
                behind, self._behind = self._behind, False
            begun = time.monotonic()
            for event in batch:
                self._step(event)
            if behind:
                stopping.wait(min(REST_SHARE * (time.monotonic() - begun), REST_SECONDS_MAX))

    def answer(self, key: str, parameters: dict[str, str]) -> Prediction:
        """To ``predict/{camera}``: for an exit at x, y at t, or from a zone. Raises `QueryError`."""
        try:
            return self._predicted(key.removeprefix("predict/"), parameters)
        except QueryError:
            self.counts["questions_refused"] += 1
            raise

    def _predicted(self, camera: str, parameters: dict[str, str]) -> Prediction:
        with self._mutex:
            predictor = self._newest()
            if predictor is None:
                raise QueryError("nothing has been learned yet")
            event = asked_exit(camera, parameters, predictor.topology.as_of)
            if "zone" not in parameters:
                return predictor.predict(event)
            zones = [zone.id for zone in predictor.zones]
            if parameters["zone"] not in zones or not parameters["zone"].startswith(f"{camera}/"):
                raise QueryError(f"camera {camera!r} has no zone {parameters['zone']!r}")
            return predictor.predict_from(zones.index(parameters["zone"]), event.t)

    def _step(self, event: Event) -> None:
        """The prediction leaves before its exit is taken note of."""
        if event.kind == "exit":
            with self._mutex:
                predictor = self._newest()
                prediction = None if predictor is None else predictor.predict(event)
            if prediction is not None:
                self._publish(prediction)
                self.counts["predictions"] += 1
        with self._mutex:
            predictor = self._newest()
            if predictor is not None:
                predictor.observe(event)

    def _newest(self) -> Predictor | None:
        """The predictor over the newest version, made when first needed."""
        topology, old = self._topology, self._predictor
        if topology is not None and (old is None or old.topology is not topology):
            self._predictor = Predictor(topology) if old is None else old.follow(topology)
        return self._predictor


def asked_exit(camera: str, parameters: dict[str, str], as_of: float) -> Event:
    """The exit a question is about; at ``as_of`` if it does not say when. Raises `QueryError`."""
    asked: dict[str, object] = {"camera": camera, "kind": "exit", "t": as_of}
    try:
        asked |= {name: float(parameters[name]) for name in ("t", "x", "y") if name in parameters}
        return codec.event_from_pack(codec.to_pack(asked))
    except codec.Rejected as error:
        raise QueryError(str(error)) from None
    except ValueError:
        raise QueryError("t, x and y are numbers") from None
