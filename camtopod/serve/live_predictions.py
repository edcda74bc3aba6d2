"""Predictions as objects leave, before their events are stored: no fit and no disk holds them
up.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

from camtopod import codec
from camtopod.predict import Predictor
from camtopod.records import Event, Prediction, Topology
from camtopod.serve.bus import QueryError
from camtopod.serve.ingest import Received
from camtopod.serve.runtime import everything
from camtopod.serve.storage import for_prediction


class Live:
    """Show it events in the order they are stored. Asked from any thread. ``owns``: the cameras
    whose exits it is for this daemon to answer.
    """

    def __init__(
        self,
        publish: Callable[[Prediction], None],
        owns: Callable[[str], bool] = everything,
    ) -> None:
        self._publish, self._owns = publish, owns
        self._mutex = threading.Lock()
        self._predictor: Predictor | None = None
        self._prepared: tuple[Topology | bytes, Predictor] | None = None
        self.counts = {"predictions": 0, "predictions_skipped": 0, "questions_refused": 0}

    def see(self, batch: Sequence[Received], seconds_max: float) -> None:
        """Events about to be stored. Those for which there is no time any more are skipped, exits
        counted.
        """
        if self._predictor is None:
            return
        until, events = (
            time.monotonic() + seconds_max,
            [one.event for one in batch if one.event is not None],
        )
        for number, event in enumerate(events):
            if time.monotonic() >= until:
                skipped = [
                    late
                    for late in events[number:]
                    if late.kind == "exit" and self._owns(late.camera)
                ]
                self.counts["predictions_skipped"] += len(skipped)
                return
            self._step(event)

    def remember(self, events: Sequence[Event]) -> None:
        """Events of before the start, so that the first predictions know what was going on."""
        if self._predictor is not None:
            for event in events:
                self._predictor.observe(event)

    def forget(self) -> None:
        """Event time has gone back, and what was observed with it."""
        with self._mutex:
            if self._predictor is not None:
                self._predictor.forget()

    def prepare(self, version: Topology | bytes) -> None:
        """Build the predictor of a version, given as such or as MessagePack, that will be used.

        Predictions by the version before go on meanwhile. To be called from one thread.
        """
        topology = for_prediction(version) if isinstance(version, bytes) else version
        self._prepared = version, Predictor(topology)

    def use(self, version: Topology | bytes) -> None:
        """Predict with a version from now on; what was observed is kept."""
        if self._prepared is None or self._prepared[0] is not version:
            self.prepare(version)
        assert self._prepared is not None
        (_, newer), self._prepared = self._prepared, None
        with self._mutex:
            if self._predictor is not None:
                newer.take_over(self._predictor)
            self._predictor = newer

    def answer(self, key: str, parameters: dict[str, str]) -> Prediction | None:
        """To ``predict/{camera}``: for an exit at x, y at t, or from a zone, by what is known then
        or at ``now``; None is no answer, as it is for another to give. Raises `QueryError`.
        """
        if not self._owns(key.removeprefix("predict/")):
            return None
        try:
            return self._predicted(key.removeprefix("predict/"), parameters)
        except QueryError:
            self.counts["questions_refused"] += 1
            raise

    def _predicted(self, camera: str, parameters: dict[str, str]) -> Prediction:
        with self._mutex:
            predictor = self._predictor
            if predictor is None:
                raise QueryError("nothing has been learned yet")
            event, now = asked_exit(camera, parameters, predictor.as_of)
            zones = [zone.id for zone in predictor.zones]
            try:
                if "zone" not in parameters:
                    return predictor.predict(event, now)
                if parameters["zone"] not in zones or not parameters["zone"].startswith(
                    f"{camera}/"
                ):
                    raise QueryError(f"camera {camera!r} has no zone {parameters['zone']!r}")
                return predictor.predict_from(zones.index(parameters["zone"]), event.t, now=now)
            except ValueError as error:
                raise QueryError(str(error)) from None

    def _step(self, event: Event) -> None:
        """The prediction leaves before its exit is taken note of."""
        if event.kind == "exit" and self._owns(event.camera):
            with self._mutex:
                prediction = None if self._predictor is None else self._predictor.predict(event)
            if prediction is not None:
                self._publish(prediction)
                self.counts["predictions"] += 1
        with self._mutex:
            if self._predictor is not None:
                self._predictor.observe(event)


def asked_exit(camera: str, parameters: dict[str, str], as_of: float) -> tuple[Event, float | None]:
    """The exit a question is about, at ``as_of`` if it does not say when, and the time it is asked
    for, None for that of the exit. Raises `QueryError`.
    """
    asked: dict[str, object] = {"camera": camera, "kind": "exit", "t": as_of}
    try:
        asked |= {name: float(parameters[name]) for name in ("t", "x", "y") if name in parameters}
        now = float(parameters["now"]) if "now" in parameters else None
        return codec.event_from_pack(codec.to_pack(asked)), now
    except codec.Rejected as error:
        raise QueryError(str(error)) from None
    except ValueError:
        raise QueryError("t, x, y and now are numbers") from None
