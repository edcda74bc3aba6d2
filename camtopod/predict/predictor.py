"""Predict where an object that has just left a zone appears next, and when.

A `Predictor` reads one topology version, observes events (`Predictor.observe`) and answers for an
exit (`Predictor.predict`): the `outlook` of the exit, with what has been observed.

Events have the times of their cameras' clocks. All times inside are *corrected times*: less the
clock offset of the camera, as given in the topology.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace

from camtopod.arrays import Floats, Rows
from camtopod.codec import require_event
from camtopod.predict.hand_over import cameras_to_watch
from camtopod.predict.outlook import Departure, Outlook, outlook
from camtopod.predict.passages import UNKNOWN, Passage
from camtopod.predict.predictor_memory import PredictorMemory, PredictorState
from camtopod.predict.time_windows import TIMED_TRANSITIONS_MIN, WINDOW
from camtopod.predict.version import PreparedVersion
from camtopod.records import Event, NextCamera, Prediction, Topology
from camtopod.topology import block_of


class Predictor:
    """Predicts by one topology version: give events to `observe`, and ask for exits with `predict`.

        >>> from camtopod import Event, Predictor, load_topology
        >>> predictor = Predictor(load_topology("topology.json"))
        >>> left = Event("lobby", "exit", 1_700_000_000.0)
        >>> likeliest = predictor.predict(left).next[0]
        >>> likeliest.zone, round(likeliest.q50)
        ('hall/1', 8)
        >>> predictor.observe(left)

    An exit may be asked for before it is observed, or afterwards.
    """

    def __init__(self, topology: Topology, prepared: PreparedVersion | None = None) -> None:
        """Begin without events; ``prepared`` is the same topology, if it is prepared already."""
        self.prepared = prepared or PreparedVersion(topology)
        self.version = self.prepared.number
        self.zones = self.prepared.zones
        self.forget()

    def forget(self) -> None:
        """Forget all observed events; needed when event time has been taken back."""
        self._memory = PredictorMemory(self.prepared)

    def take_over(self, older: Predictor) -> None:
        """Take over the observed events from a predictor by an older version; this must be new."""
        self._memory.take_over(older._memory)

    def save(self) -> PredictorState:
        """Return the state from which `load` continues, given the same topology."""
        return self._memory.save()

    def load(self, state: PredictorState) -> None:
        """Continue from a state saved with the same topology; this predictor must be new."""
        self._memory.load(state)

    def observe(self, event: Event) -> None:
        """Observe an event; events should be given in order of time as far as possible.

        Raise ValueError for an event that is neither entry nor exit, or without a time.
        """
        require_event(event)
        self._memory.observe(event, self.zone_of(event))

    def zone_of(self, event: Event) -> int | None:
        """Return the zone (index) that an event belongs to; None if its camera has no zone."""
        return self.prepared.zone_of(event)

    def zone_id_of(self, event: Event) -> str | None:
        """Return the id of the zone that an event belongs to; None if its camera has no zone."""
        zone = self.zone_of(event)
        return None if zone is None else self.zones[zone].id

    def predict(self, event: Event, now: float | None = None) -> Prediction:
        """Return the prediction where and when the object of an exit appears next.

        event: the exit.
        now (seconds by the camera's clock): moment of the question; None for the moment of the
            exit. Later, the exit may have been observed, too, and windows may lie before ``now``
            where an arrival may have been that of the object.

        Raise `UnknownPlace` (a KeyError) for a camera that the version does not have, ValueError
        for an event that is no exit, or a ``now`` before it.
        """
        require_event(event, "exit")
        self.prepared.require_camera(event.camera)
        return self.answer(event, now)

    def answer(self, event: Event, now: float | None = None) -> Prediction:
        """Return what `predict` does; of a camera that is new since the version, nothing is known.

        event: an exit.
        """
        zone = self.zone_of(event)
        track = None if event.track is None else str(event.track)
        if zone is None:
            _check(event.t, now)
            return Prediction(event.camera, None, event.t, track, self.version, 1.0, [], prior=True)

        passages = self._memory.passages
        passage = None if track is None else passages.left_at(event.camera, track, event.t)
        block = block_of(event.x, event.y)
        return self.predict_from(zone, event.t, passage, track, block, now, event.label)

    def predict_from(
        self,
        zone: int,
        t: float,
        passage: Passage | None = None,
        track: str | None = None,
        block: int | None = None,
        now: float | None = None,
        label: str | None = None,
    ) -> Prediction:
        """Return the prediction for an exit whose zone is known; see `predict`.

        zone: index of the zone of the exit.
        t (seconds by the clock of the zone's camera): time of the exit.
        passage: the passage that ends with the exit; None if unknown.
        track: track of the exit, for the record only.
        block: block of the image where the object left (`camtopod.topology.block_of`); None if
            unknown.
        now: as for `predict`.
        label: class of the object; None for that of its entry.
        """
        _check(t, now)
        entry_passage = passage or UNKNOWN
        site_t = t - self.prepared.offset_of[zone]
        departure = Departure(
            zone,
            site_t,
            passage,
            block,
            self.prepared.labels.number(label, entry_passage.label),
            elapsed=0.0 if now is None else now - t,
        )
        answer = outlook(self.prepared, departure, self._memory.seen(departure))
        next_cameras = self._following(answer)
        exit_zone = self.zones[zone]
        prediction = Prediction(
            *(exit_zone.camera, exit_zone.id, t, track, self.version, answer.leave, next_cameras),
            prior=not self.prepared.is_learned(zone),
        )
        if (
            passage is None
            or now is not None
            or not self.prepared.hand_over.overlaps(exit_zone.camera)
        ):
            return prediction

        # The hand-over, where views overlap.
        in_view = self.prepared.hand_over.in_view(
            passage,
            site_t,
            self._memory.passages,
            self.prepared.clock_offset,
            self.prepared.labels,
        )
        return replace(prediction, look=cameras_to_watch(in_view, next_cameras), in_view=in_view)

    def _following(self, answer: Outlook) -> list[NextCamera]:
        """Return the next appearances by an outlook, likeliest first.

        There is a row for each that links tell, and one for each camera where it may be anywhere.
        """
        cameras = np.flatnonzero(answer.elsewhere)
        zones = self.prepared.anywhere.busiest[cameras]
        probability = answer.elsewhere[cameras]
        windows = self._windows_anywhere(answer, zones)
        is_guess = np.ones(len(zones), np.bool_)
        if answer.table is not None:
            rows = np.flatnonzero(answer.chance)
            zones = np.append(answer.table.outcomes.targets[rows], zones)
            probability = np.append(answer.chance[rows], probability)
            windows = np.concatenate((answer.windows(rows), windows))
            is_guess = np.append(answer.table.transitions[rows] < TIMED_TRANSITIONS_MIN, is_guess)

        order = np.argsort(-probability, kind="stable")
        camera, zone_id = (names[zones] for names in self.prepared.zone_names)
        columns = (camera, zone_id, probability, *np.round(windows, 3).T, is_guess)
        return list(map(NextCamera, *(column[order].tolist() for column in columns)))

    def _windows_anywhere(self, answer: Outlook, zones: Rows) -> Floats:
        """Return the time windows (zones, 3, seconds) of appearing after no particular lag."""
        first, last = answer.span
        lags = np.tile(first + np.array(WINDOW) * (last - first), (len(zones), 1))
        if not self.prepared.is_corrected:
            offset = self.prepared.offset_of
            lags += (offset[zones] - offset[answer.departure.zone])[:, None]
        return lags


def _check(t: float, now: float | None) -> None:
    """Raise ValueError for a question before the exit."""
    if now is not None and not t <= now < math.inf:
        raise ValueError(
            f"now is {now}: give the time of the exit, {t}, or a later one, in seconds"
        )
