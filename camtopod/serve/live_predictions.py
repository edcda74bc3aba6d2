"""Predictions as objects leave, before their events are stored: no fit and no disk holds them
up.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

from camtopod import codec
from camtopod.cooperative import Pause, no_pause
from camtopod.predict import Predictor
from camtopod.records import Event, Prediction, Topology
from camtopod.serve.bus import QueryError
from camtopod.serve.ingest import Received
from camtopod.serve.runtime import Leisure, everything, let_go, memory
from camtopod.serve.storage import for_prediction


class Live:
    """Show it events in the order they are stored. Asked from any thread. ``owns``: the cameras
    whose exits it is for this daemon to answer. ``rest``: as of `Leisure`.
    """

    def __init__(
        self,
        publish: Callable[[Prediction], None],
        owns: Callable[[str], bool] = everything,
        rest: Callable[[float], object] = time.sleep,
    ) -> None:
        self._publish, self._owns, self._rest = publish, owns, rest
        self._mutex = threading.Lock()
        self._predictor: Predictor | None = None
        self._prepared: tuple[Topology | bytes, Predictor] | None = None
        self._older: list[object] = []
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

    def prepare(self, version: Topology | bytes, hurried: bool = False) -> None:
        """A version that is about to be used, as such or as MessagePack: what takes long is done,
        and predictions go on meanwhile; none of them is held up unless it is ``hurried``. One
        thread.
        """
        pause: Pause = no_pause if hurried or self._predictor is None else Leisure(self._rest)
        read = for_prediction(version, pause) if isinstance(version, bytes) else version
        prepared = Predictor(read, pause)
        prepared.make_ready(self._owns, pause)
        self._prepared = version, prepared
        if read is not version:
            wholes: list[object] = [read]
            del read
            let_go(wholes, pause)

    def use(self, version: Topology | bytes) -> None:
        """Predict from this version on, remembering what was observed; then call `forget_older`."""
        prepared, newer = self._prepared or (None, None)
        if newer is None or prepared is not version:
            newer = Predictor(for_prediction(version) if isinstance(version, bytes) else version)
        self._prepared = None
        with self._mutex:
            older = self._predictor
            if older is not None:
                newer.take_over(older)
            self._predictor = newer
        if older is not None:
            self._older.append(older)

    def forget_older(self) -> None:
        """Let go of what was used before, bit by bit. In the thread of `use`."""
        let_go(self._older, Leisure(self._rest))
        memory.give_back()

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
