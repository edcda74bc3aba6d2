"""Predict where objects appear next, as they leave and before their events are stored.

Neither a fit nor a slow disk delays a prediction.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

from camtopod import codec
from camtopod.predict import Predictor
from camtopod.records import Event, Prediction
from camtopod.serve.bus import QueryError
from camtopod.serve.ingest import Received


class Live:
    """Publishes a prediction for each exit, and answers queries for predictions (any thread).

    Events have to be passed in the order in which they are stored.

    publish: called with each prediction.
    """

    def __init__(self, publish: Callable[[Prediction], None]) -> None:
        self._publish = publish
        self._mutex = threading.Lock()
        self._predictor: Predictor | None = None
        self.counts = {"predictions": 0, "predictions_skipped": 0, "questions_refused": 0}

    def see(self, batch: Sequence[Received], seconds_max: float) -> None:
        """Predict the exits of a batch that is about to be stored, and observe its events.

        After ``seconds_max`` the rest of the batch is skipped, and its exits are counted.
        """
        if self._predictor is None:
            return
        until = time.monotonic() + seconds_max
        events = [one.event for one in batch if one.event is not None]
        for number, event in enumerate(events):
            if time.monotonic() >= until:
                late = events[number:]
                self.counts["predictions_skipped"] += sum(one.kind == "exit" for one in late)
                return

            # Predict an exit, observe the event, and publish the prediction.
            prediction = None
            with self._mutex:
                if event.kind == "exit":
                    prediction = self._predictor.predict(event)
                self._predictor.observe(event)
            if prediction is not None:
                self._publish(prediction)
                self.counts["predictions"] += 1

    def remember(self, events: Sequence[Event]) -> None:
        """Observe events from before the start, so that the first predictions consider them."""
        if self._predictor is not None:
            for event in events:
                self._predictor.observe(event)

    def forget(self) -> None:
        """Forget all observed events, as event time has been set back."""
        with self._mutex:
            if self._predictor is not None:
                self._predictor.forget()

    def use(self, predictor: Predictor) -> None:
        """Predict with a newer version from now on; the observed events are kept."""
        with self._mutex:
            if self._predictor is not None:
                predictor.take_over(self._predictor)
            self._predictor = predictor

    def answer(self, key: str, parameters: dict[str, str]) -> Prediction:
        """Answer a query on ``predict/{camera}``: for an exit at x, y at t, or from a zone.

        It uses what was observed up to that time, or up to ``now`` if given. Raises `QueryError`.
        """
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
            try:
                if "zone" not in parameters:
                    return predictor.predict(event, now)
                for number, zone in enumerate(predictor.zones):
                    if zone.camera == camera and zone.id == parameters["zone"]:
                        return predictor.predict_from(number, event.t, now=now)
                raise QueryError(f"camera {camera!r} has no zone {parameters['zone']!r}")
            except ValueError as error:
                raise QueryError(str(error)) from None


def asked_exit(camera: str, parameters: dict[str, str], as_of: float) -> tuple[Event, float | None]:
    """Return the exit that a query is about, and its ``now``; raise `QueryError`.

    as_of: time of the exit if the query does not give one.
    """
    asked: dict[str, object] = {"camera": camera, "kind": "exit", "t": as_of}
    try:
        asked |= {name: float(parameters[name]) for name in ("t", "x", "y") if name in parameters}
        now = float(parameters["now"]) if "now" in parameters else None
        return codec.event_from_msgpack(codec.to_msgpack(asked)), now
    except codec.Rejected as error:
        raise QueryError(str(error)) from None
    except ValueError:
        raise QueryError("t, x, y and now are numbers") from None
