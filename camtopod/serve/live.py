"""Predictions as objects leave: a path of its own that no refit and no disk holds up."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable, Sequence

from camtopod import codec
from camtopod.learn.predict import Predictor
from camtopod.records import Event, Prediction, Topology
from camtopod.serve.bus import QueryError
from camtopod.serve.progress import Beat, no_beat

log = logging.getLogger(__name__)

_TICK_SECONDS = 0.2


class Live:
    """Feed it events in the order they were stored; run `work` in a thread of its own."""

    def __init__(self, events_max: int, publish: Callable[[Prediction], None]) -> None:
        self._queue: queue.Queue[Event] = queue.Queue(events_max)
        self._publish = publish
        self._mutex = threading.Lock()
        self._predictor: Predictor | None = None
        self._topology: Topology | None = None
        self.counts = {"predictions": 0, "predictions_skipped": 0, "questions_refused": 0}

    def feed(self, event: Event) -> None:
        """An event just stored. Never blocks: what cannot be predicted in time is skipped and counted."""
        try:
            self._queue.put_nowait(event)
        except queue.Full:
            self.counts["predictions_skipped"] += 1

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
            try:
                event = self._queue.get(timeout=_TICK_SECONDS)
            except queue.Empty:
                continue
            prediction = self._step(event)
            if prediction is not None:
                self._publish(prediction)
                self.counts["predictions"] += 1

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

    def _step(self, event: Event) -> Prediction | None:
        with self._mutex:
            predictor = self._newest()
            if predictor is None:
                return None
            prediction = predictor.predict(event) if event.kind == "exit" else None
            predictor.observe(event)
            return prediction

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
