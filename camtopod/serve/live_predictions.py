"""Predict where objects appear next, as their exits are heard.

Neither a fit nor a disk delays a prediction. Each entry is matched with earlier passages as
well (`camtopod.predict.Walks`), while nothing else waits and in a share of the time: a site that is
too busy has fewer matches, not later predictions. Passages are kept in memory only, for an hour at
most.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from itertools import takewhile

from msgspec.structs import replace

from camtopod import codec
from camtopod.predict import RECENT_MAX, BetweenCameras, Predictor, Walks, cameras_to_watch
from camtopod.records import Between, Event, Match, Prediction, Recent, SeenEvent, Topology
from camtopod.serve.bus import QueryError
from camtopod.serve.hourly_counts import HourlyCounts
from camtopod.topology import UnknownPlace, zone_at
from camtopod.words import present_of

FRESH_SECONDS = 30.0
"""Age of an event from which on, if it was not heard, it is one of a backlog: only observed.

Matches of older entries are not published either.
"""
RECENT_SECONDS = 3600.0
"""How long events are remembered, before the newest one; older ones are no part of walks either."""
RECENT_EVENTS_MAX = 50_000
"""Largest number of events that are remembered for ``recent``."""
MATCHING_SHARE = 0.1
"""Largest share of time in which entries are matched, of one core."""
MATCHING_SECONDS_MAX = 0.1
"""Time for matching that adds up while there is none."""
UNMATCHED_MAX = 1_000
"""Largest number of events that wait to be matched; entries beyond it have no match."""
OUTLOOKS_AT_ONCE_MAX = 10
"""Most outlooks that are computed for a match at a time; a prediction waits no longer than that."""
REVISED_AT_ONCE_MAX = 3
"""Largest number of entries whose matches are looked at once more at a time."""


class Reader:
    """What reads one version for live answers: predictor and walks. Making it takes long.

    walks: True to match entries with earlier passages.
    outside (zones, 1/s): as for `Walks`.
    """

    def __init__(
        self, topology: Topology, walks: bool, outside: Sequence[float] | None = None
    ) -> None:
        self.predictor = Predictor(topology)
        self.walks = Walks(topology, self.predictor.prepared, outside) if walks else None

    def published(self, prediction: Prediction) -> Prediction:
        """Return a prediction as it is published: without walks, nothing joins two passages."""
        if self.walks is not None or prediction.in_view is None:
            return prediction
        return replace(prediction, look=cameras_to_watch((), prediction.next), in_view=None)

    def take_over(self, older: Reader) -> None:
        """Take over the observed events from the reader of an older version; this must be new."""
        self.predictor.take_over(older.predictor)
        if self.walks is not None and older.walks is not None:
            self.walks.take_over(older.walks)


class Live:
    """Publishes a prediction for each exit and a match for each entry, and answers queries.

    Events come in the order in which they are heard, each once. Queries may come from any thread.

    publish: called with each prediction and each match.
    clock: returns the present moment (Unix seconds).
    processor_time: returns the processor time that this thread has used (seconds).
    """

    def __init__(
        self,
        publish: Callable[[Prediction | Match], None],
        clock: Callable[[], float],
        processor_time: Callable[[], float] = time.thread_time,
    ) -> None:
        self._publish = publish
        self._clock = clock
        self._mutex = threading.Lock()
        self._reader: Reader | None = None
        self._recent: deque[tuple[float, SeenEvent]] = deque(maxlen=RECENT_EVENTS_MAX)
        """With the moment of each event's receipt, in that order."""
        self.newest_t = -math.inf
        """Time of the newest event, Unix seconds."""
        self._hours = HourlyCounts(clock())
        self._between = BetweenCameras(clock())
        """It begins anew when exits are not predicted, or entries not matched."""
        self._match_queue: deque[Event] = deque()
        """Events that wait to be matched, oldest first."""
        self._processor_time = processor_time
        self._budget_seconds, self._budget_at = MATCHING_SECONDS_MAX, time.monotonic()
        self.counts = {
            "predictions": 0,
            "matches_skipped": 0,
            "questions_refused": 0,
        }

    def hear(self, event: Event, is_delivered: bool = False) -> None:
        """Observe an event, and publish the prediction of an exit.

        is_delivered: it was not heard when it happened, so it may be one of a backlog.
        """
        age = self._clock() - event.t
        is_backlog = is_delivered and age >= FRESH_SECONDS
        with self._mutex:
            prediction = None if is_backlog else self._predict(event)
            self._observe(event)
            if not is_backlog:
                self._let_wait(event)
            elif age < RECENT_SECONDS:
                self._observe_walk(event)
        if prediction is not None:
            self.counts["predictions"] += 1
            self._publish(prediction)

    def match(self, is_busy: Callable[[], bool]) -> None:
        """Match the entries that were heard, and publish the matches, except those of a backlog.

        It ends when all are matched, when others have work, or when its time is used up.

        is_busy: returns True if others have work.
        """
        is_done = False
        while not (is_done or is_busy() or self._seconds_for_matching() <= 0.0):
            start = self._processor_time()
            with self._mutex:
                matches, is_done = self._match_next()
            for match in matches:
                if self._clock() - match.t <= FRESH_SECONDS:
                    self._publish(match)
            self._budget_seconds -= self._processor_time() - start

    def _predict(self, event: Event) -> Prediction | None:
        """Return the prediction of an exit."""
        if self._reader is None or event.kind != "exit":
            return None
        prediction = self._reader.predictor.answer(event)
        self._between.left(prediction)
        return self._reader.published(prediction)

    def _observe(self, event: Event) -> None:
        """Observe an event for predictions and for ``recent``."""
        self._remember(event, self._clock())
        if self._reader is not None:
            self._reader.predictor.observe(event)

    def _observe_walk(self, event: Event) -> None:
        """Observe an event for matches to come, without one for itself."""
        if self._reader is not None and self._reader.walks is not None:
            self._reader.walks.observe(event, is_matched=False)

    def _let_wait(self, event: Event) -> None:
        """Let an event wait to be matched; the oldest of too many is observed without a match."""
        if self._reader is None or self._reader.walks is None:
            return
        self._match_queue.append(event)
        if len(self._match_queue) > UNMATCHED_MAX:
            oldest = self._match_queue.popleft()
            self.counts["matches_skipped"] += oldest.kind == "entry"
            self._observe_walk(oldest)
            self._between = BetweenCameras(self._clock())

    def _match_next(self) -> tuple[list[Match], bool]:
        """Return the match of the oldest event that waits, and whether that was all.

        If none waits, return matches that have changed since.
        """
        walks = None if self._reader is None else self._reader.walks
        if walks is None:
            return [], True
        is_done = not self._match_queue
        if is_done:
            matches = walks.revised(self._clock(), REVISED_AT_ONCE_MAX)
        elif not walks.prepare(self._match_queue[0], OUTLOOKS_AT_ONCE_MAX):
            matches = []
        else:
            first = walks.observe(self._match_queue.popleft())
            matches = [] if first is None else [first]
        for match in matches:
            self._between.entered(match)
        return matches, is_done

    def _seconds_for_matching(self) -> float:
        """Return the processor time that matching may take at present, seconds."""
        now = time.monotonic()
        gain = MATCHING_SHARE * (now - self._budget_at)
        self._budget_seconds = min(self._budget_seconds + gain, MATCHING_SECONDS_MAX)
        self._budget_at = now
        return self._budget_seconds

    def _remember(self, event: Event, receipt_time: float) -> None:
        """Remember an event for ``recent``."""
        zone = label = None
        if self._reader is not None:
            predictor = self._reader.predictor
            zone, label = predictor.zone_id_of(event), predictor.prepared.labels.name(event.label)
        seen_event = SeenEvent(event.t, event.camera, event.kind, zone, event.x, event.y, label)
        self._hours.add(seen_event)
        self.newest_t = max(self.newest_t, event.t)
        self._recent.append((receipt_time, seen_event))
        while self._recent and self._recent[0][1].t < self.newest_t - RECENT_SECONDS:
            self._recent.popleft()

    def remember(self, events: Sequence[Event]) -> None:
        """Observe events from before the start, by time: the first answers consider them."""
        with self._mutex:
            self._hours.since = min([self._hours.since, *(event.t for event in events[:1])])
            for event in events:
                self._remember(event, event.t)
            for event in events[-2 * RECENT_MAX :]:
                if self._reader is not None and event.t > self.newest_t - RECENT_SECONDS:
                    self._reader.predictor.observe(event)
                    if self._reader.walks is not None:
                        self._reader.walks.observe(event)

    def forget_cameras(self, cameras: Collection[str]) -> None:
        """Forget cameras' events and passages; the predictor does so with the next version."""
        with self._mutex:
            recent = [(t, event) for t, event in self._recent if event.camera not in cameras]
            self._recent = deque(recent, maxlen=RECENT_EVENTS_MAX)
            self._hours.forget_cameras(cameras)
            self._between.forget_cameras(cameras)
            self._match_queue = deque(
                event for event in self._match_queue if event.camera not in cameras
            )
            if self._reader is not None and self._reader.walks is not None:
                self._reader.walks.forget_cameras(cameras)

    def forget(self) -> None:
        """Forget all observed events, as event time has been set back."""
        with self._mutex:
            self._recent.clear()
            self.newest_t = -math.inf
            self._match_queue.clear()
            self._hours = HourlyCounts(self._clock())
            self._between = BetweenCameras(self._clock())
            if self._reader is not None:
                self._reader.predictor.forget()
                if self._reader.walks is not None:
                    self._reader.walks.forget()

    def use(self, reader: Reader) -> None:
        """Answer by a newer version from now on; the observed events are kept."""
        with self._mutex:
            if self._reader is not None:
                reader.take_over(self._reader)
            self._reader = reader

    def between(self, pairs_max: int | None) -> Between | None:
        """Return how many objects are between cameras; None without matches.

        pairs_max: number of pairs of cameras, those with most objects; None for all.
        """
        with self._mutex:
            if self._reader is None or self._reader.walks is None:
                return None
            return self._between.expected(self._clock(), pairs_max)

    def recent(self, key: str, parameters: dict[str, str]) -> Recent:
        """Answer a query on ``recent``: the events of the last hour up to the newest event.

        With ``since`` only those received later, so that a reader who gives the time of the answer
        before gets each event once; with ``hours`` the counts of a day as well. Raises
        `QueryError`.
        """
        try:
            since = float(parameters.get("since", "-inf"))
        except ValueError:
            self.counts["questions_refused"] += 1
            raise QueryError("since is a number, Unix seconds") from None
        with self._mutex:
            now = self._clock()
            oldest_t = self.newest_t - RECENT_SECONDS
            newest = takewhile(lambda pair: pair[0] > since, reversed(self._recent))
            events = [event for _, event in newest if event.t >= oldest_t][::-1]
            if "hours" not in parameters:
                return Recent(now, events)
            return Recent(now, events, self._hours.told(present_of(now, self.newest_t)))

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
            if self._reader is None:
                raise QueryError("nothing has been learned yet")
            predictor = self._reader.predictor
            event, now = asked_exit(camera, parameters, predictor.prepared.as_of)
            try:
                if "zone" in parameters:
                    zone = zone_at(predictor.version, predictor.zones, parameters["zone"], camera)
                    return predictor.predict_from(zone, event.t, now=now, label=event.label)
                return predictor.predict(event, now)
            except (ValueError, UnknownPlace) as error:
                raise QueryError(str(error)) from None


def asked_exit(camera: str, parameters: dict[str, str], as_of: float) -> tuple[Event, float | None]:
    """Return the exit that a query is about, and its ``now``; raise `QueryError`.

    as_of: time of the exit if the query does not give one.
    """
    fields: dict[str, object] = {"camera": camera, "kind": "exit", "t": as_of}
    try:
        fields |= {name: float(parameters[name]) for name in ("t", "x", "y") if name in parameters}
        fields |= {"label": parameters["label"]} if "label" in parameters else {}
        now = float(parameters["now"]) if "now" in parameters else None
        return codec.event_from_msgpack(codec.to_msgpack(fields)), now
    except codec.Rejected as error:
        raise QueryError(str(error)) from None
    except ValueError:
        raise QueryError("t, x, y and now are numbers") from None
