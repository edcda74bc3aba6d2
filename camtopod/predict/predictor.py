"""Where an object that has just left will appear next: competing outcomes, weighed by what has been
seen since.

For an exit at zone u the outcomes are: appearing at each zone v with a lag, or not being seen
again. Their prior odds are the learned hazards, all of them, weak evidence included. Five things
are then known at the time of the exit:

* *context*: where the object came in, where exactly it left, from which camera it probably came before;
* *exposure*: a lag of -L is only possible if this passage has lasted L;
* *seen*: where views overlap the object may already have appeared; each recent arrival counts for its hazard over the
  rate of everything else that could have caused it, and an overlapped view without an arrival loses its share;
* *pace*: who was slow in this view takes longer to the next;
* *alive*: a camera silent for far longer than its traffic allows is not where objects will be seen.

Asked again later, what would have shown by then has lost its odds to the rest, and each arrival
since the exit counts as those before it do; both by the object's pace. Windows are those of the
odds that remain.

Events come with their cameras' own clocks; inside, times are right ones, as far as the topology
knows the clocks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from operator import mul

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from camtopod.arrays import Floats
from camtopod.cooperative import Pause, no_pause, unhurried
from camtopod.predict.contexts import Surroundings
from camtopod.predict.exit_tables import AtExit, Ready, ReadyZones, Site
from camtopod.predict.hand_over import HandOver, look
from camtopod.predict.hazards import Hazards
from camtopod.predict.open_passages import Passage, UnderWay
from camtopod.predict.recent_events import (
    RECENT_MAX,
    Arrival,
    Recent,
    RecentArrivals,
    renumbered,
    take_over_arrivals,
    take_over_exits,
)
from camtopod.predict.speed import Paces
from camtopod.predict.time_windows import paced, quantiles, unknown
from camtopod.predict.zone_lookup import Places
from camtopod.records import Event, NextCamera, Prediction, Topology, Zone
from camtopod.topology import LEAVE_FLOOR, block_of

DEAD_PRIOR = 1e-3
"""Prior probability that a camera has gone silent for good."""
SILENCE_NATS_MAX = 50.0
NEXT_PROBABILITY_MIN = 1e-4
"""Outcomes less likely than this are left out."""
RATE_MIN = 1e-6


class PredictorState(Struct):
    """What a `Predictor` has observed; what it knows beside that is its topology.

    Passages that have ended are left out: they only matter to who asks again about an exit.
    """

    arrivals: list[Arrival]
    exit_times: Floats
    exit_zones: NDArray[np.int32]
    under_way: list[tuple[str, str, Passage]]
    events: int
    last_event: dict[str, int]


class Predictor:
    """Prediction over one topology version. `observe` keeps it abreast of events; `predict` answers
    for an exit.

    An exit is to be predicted before it is observed, else it competes with itself; not so where
    `predict` is told when it is asked. ``pause`` is called often while it is made. Of the topology
    it keeps the zones.
    """

    def __init__(self, topology: Topology, pause: Pause = no_pause) -> None:
        self.version, self.as_of, self.zones = topology.version, topology.as_of, topology.zones
        self._hazards = Hazards(topology, pause)
        self._surroundings = Surroundings(topology, pause)
        self._paces = Paces(topology)
        site = Site(topology, self._hazards, self._paces)
        self._ready = ReadyZones(site)
        self._hand_over = HandOver(topology)
        self._places = Places(self.zones)
        self._of_camera = self._places.of_camera
        self._ahead, self._clocks_apart = site.ahead, site.clocks_apart
        stay_max = {
            camera: self._hazards.longest_stay(zones) for camera, zones in self._of_camera.items()
        }
        self._stay_max = {camera: stay for camera, stay in stay_max.items() if stay}
        self._ahead_of = np.array([self._ahead.get(zone.camera, 0.0) for zone in self.zones])
        self._wanted = np.zeros(len(self.zones), np.bool_)  # all False between calls
        self._row_of = np.full(len(self.zones), -1, np.intp)  # all -1 between calls
        self._names, self._camera_of = list(site.cameras), site.camera_of
        self._number_of: list[int] = self._camera_of.tolist()
        self.forget()

    def forget(self) -> None:
        """Nothing has been observed (any more): event time has gone back."""
        self._under_way = UnderWay(self._stay_max)
        self._arrivals, self._exits = RecentArrivals(), Recent()
        self._events = 0
        self._last_event = [0] * len(self._names)
        """Of each camera, by the count of all events."""

    def make_ready(self, wanted: Callable[[str], bool], pause: Pause = no_pause) -> None:
        """Work out for each zone of the cameras ``wanted`` what would else be worked out at its
        first exit.
        """
        for k, zone in enumerate(unhurried(self.zones, pause)):
            if wanted(zone.camera):
                self.predict_from(k, self.as_of)

    def follow(self, topology: Topology) -> Predictor:
        """A predictor over a newer version that remembers what this one has observed."""
        newer = Predictor(topology)
        newer.take_over(self)
        return newer

    def take_over(self, older: Predictor) -> None:
        """Remember what one over an older version has observed; this one must be new."""
        moved = renumbered(older.zones, self.zones)
        take_over_arrivals(self._arrivals, older._arrivals, moved)
        take_over_exits(self._exits, older._exits, moved)
        self._under_way.take_over(older._under_way, moved)
        self._events = older._events
        last_event = dict(zip(older._names, older._last_event, strict=True))
        self._last_event = [last_event.get(camera, older._events) for camera in self._names]

    def save(self) -> PredictorState:
        """Everything `load` needs, beside the topology, to go on from here."""
        under_way, exits = self._under_way.passages(), self._exits.save()
        last_event = dict(zip(self._names, self._last_event, strict=True))
        return PredictorState(
            self._arrivals.arrivals(), *exits, under_way, self._events, last_event
        )

    def load(self, state: PredictorState) -> None:
        """Go on from there, over the same topology."""
        for arrival in state.arrivals:
            self._arrivals.append(arrival.t, arrival.zone, arrival.rate)
        self._exits.load(state.exit_times, state.exit_zones)
        for camera, track, passage in state.under_way:
            self._under_way.begin(camera, track, passage)
        self._events = state.events
        self._last_event = [state.last_event[camera] for camera in self._names]

    def observe(self, event: Event) -> None:
        """Take note of an event; they must come by time as far as that is possible."""
        self._events += 1
        zone = self.zone_of(event)
        if zone is None:
            return
        self._last_event[self._number_of[zone]] = self._events
        t = event.t - self._ahead[event.camera]
        if event.kind == "entry":
            causes = self._causes(zone, t)
            rate = self._hazards.arrival_rate[zone] + sum(causes.values())
            self._arrivals.append(t, zone, rate)
            if event.track is not None:
                previous = max(causes, key=causes.__getitem__, default=None)
                sure = causes[previous] / rate if previous is not None else 0.0
                passage = Passage(t, event.camera, zone, previous, sure)
                self._under_way.begin(event.camera, str(event.track), passage)
                self._share_with_simultaneous(passage)
                self._under_way.forget_stale(t)
            return
        left = (
            None
            if event.track is None
            else self._under_way.end(event.camera, str(event.track), event.t)
        )
        self._exits.append(t, zone)
        self._share_causes(zone, t, left)

    def zone_of(self, event: Event) -> int | None:
        """Index of the zone the event most likely belongs to; None for a camera without zones."""
        return self._places.zone_of(event)

    def predict(self, event: Event, now: float | None = None) -> Prediction:
        """Next appearance of the object of an exit, by what is known at the exit.

        Or, asked again, by what is known at ``now``, seconds by the same camera's clock. The exit
        may have been observed since. Where an arrival may have been the object's, the window may
        lie before ``now``. Raises ValueError for a ``now`` before the exit.
        """
        _check(event.t, now)
        zone = self.zone_of(event)
        track = None if event.track is None else str(event.track)
        if zone is None:
            return Prediction(event.camera, None, event.t, track, self.version, 1.0, [])
        passage = None
        if track is not None and now is None:
            passage = self._under_way.get(event.camera, track)
        elif track is not None:
            passage = self._under_way.left_at(event.camera, track, event.t)
        return self.predict_from(zone, event.t, passage, track, block_of(event.x, event.y), now)

    def predict_from(
        self,
        zone: int,
        t: float,
        passage: Passage | None = None,
        track: str | None = None,
        block: int | None = None,
        now: float | None = None,
    ) -> Prediction:
        """The same for an object that left a zone (index) at ``t`` by the clock of the zone's
        camera, after a passage and in a block of the image, if known.
        """
        _check(t, now)
        here, ready = self.zones[zone], self._ready.of(zone)
        if ready is None:
            return self._prediction(here, t, track, 1.0, [], passage)
        left, outcomes, edges = (
            t - self._ahead[here.camera],
            ready.outcomes,
            self._hazards.bins.edges,
        )
        entry, previous, sure, stay = None, None, 0.0, None
        if passage is not None:
            entry, previous, sure, stay = (
                passage.entry,
                passage.previous,
                passage.sure,
                left - passage.t,
            )
        pace = self._paces.of_passage(entry, zone, stay)
        observed = now is not None and self._has_left(zone, left)
        if observed:
            mass, known = self._odds(zone, ready, left, passage, observed), None
            odds: list[float] = mass.sum(axis=1).tolist()
        else:
            known = self._at_exit(ready, left, passage)
            odds = known.odds
        likelier, leave = self._surroundings.multipliers(
            zone, outcomes, block, entry, previous, sure
        )
        odds = list(map(mul, odds, likelier))
        leave += math.fsum(map(mul, ready.doubt, odds))
        if (
            now is not None and now > t
        ):  # what may as well be chance was so at the exit: it is gone, seen or not
            slower, pace = 1.0 if pace is None else pace[0], None
            mass, known = self._odds(zone, ready, left, passage, observed, now - t, slower), None
            edges, leave = paced(edges, slower), max(leave, LEAVE_FLOOR)
            odds = list(map(mul, mass.sum(axis=1).tolist(), likelier))
        odds = list(map(mul, odds, ready.sure))
        least = NEXT_PROBABILITY_MIN * (leave + math.fsum(odds))
        order = [
            k
            for k in sorted(range(len(odds)), key=odds.__getitem__, reverse=True)
            if odds[k] >= least
        ]
        kept = leave + math.fsum(odds[k] for k in order)
        if known is None:
            lags = quantiles(mass[order], edges)
            windows: Sequence[Sequence[float]] = [
                ready.window(k, pace, usual) for k, usual in zip(order, lags, strict=True)
            ]
        else:
            windows = ready.windows(order, pace, known)
        following = [
            NextCamera(ready.targets[k].camera, ready.targets[k].id, odds[k] / kept, *times)
            for k, times in zip(order, windows, strict=True)
        ]
        return self._prediction(
            here, t, track, leave / kept, following, passage if now is None else None
        )

    def _prediction(
        self,
        here: Zone,
        t: float,
        track: str | None,
        leave: float,
        following: list[NextCamera],
        passage: Passage | None,
    ) -> Prediction:
        """With who sees the object at the exit, where its ``passage`` is known and other views
        overlap.
        """
        if passage is None or not self._hand_over.overlaps(here.camera):
            return Prediction(here.camera, here.id, t, track, self.version, leave, following)
        in_view = self._hand_over.in_view(
            passage, t - self._ahead[here.camera], self._under_way, self._ahead
        )
        seen = look(in_view, following)
        return Prediction(
            here.camera, here.id, t, track, self.version, leave, following, seen, in_view
        )

    def _at_exit(self, ready: Ready, t: float, passage: Passage | None) -> AtExit:
        """`_odds` for an exit that has not been observed, by what is known then."""
        stay, alive = None if passage is None else t - passage.t, self._alive(ready)
        odds = list(map(mul, ready.odds(stay), alive))
        arrivals, hazards, came_there = self._arrivals, self._hazards, dict[int, dict[int, float]]()
        counts, since = (
            arrivals.dropped + arrivals.first,
            -math.inf if passage is None else passage.t,
        )
        oldest = max(t + hazards.bins.lag_min, since)
        for k, target, later, earliest, ahead, kernels, hazard in ready.before:
            entered = passage is not None and passage.entry in kernels
            reach = oldest if entered else max(oldest, t + earliest)
            for came, number in reversed(arrivals.of_zone.get(target, ())):
                if came < reach:
                    break
                if came < since or came + later >= t or number < counts:
                    continue
                if came == since and not self._in_view(target, came, t):
                    continue  # the two passages began together and the other ended first, so it was the earlier one
                at = hazards.bin_of(came - t)
                here = hazard.get(at, 0.0)
                if at < 0 or not (here or entered):
                    continue
                here, rate = (
                    here and here * ready.exposure(at, stay),
                    arrivals.rate.item(number - arrivals.dropped),
                )
                if passage is not None:
                    from_view = (
                        hazards.rate_entered(passage.entry, target, came - since)
                        if entered
                        else 0.0
                    )
                    here, rate = here + from_view, rate - (from_view + ahead)
                if here:
                    more = here / max(rate, RATE_MIN)
                    odds[k] += more
                    there = came_there.setdefault(k, {})
                    there[at] = there.get(at, 0.0) + more
        return AtExit(odds, alive, came_there, stay)

    def _odds(
        self,
        zone: int,
        ready: Ready,
        t: float,
        passage: Passage | None,
        observed: bool,
        elapsed: float = 0.0,
        slower: float = 1.0,
    ) -> Floats:
        """Odds of every (target, lag bin), (targets, bins), beside those of not being seen again.

        ``observed``: the exit has been, so that arrivals have it among their causes. ``elapsed``:
        what is known so many seconds after it, of an object that takes ``slower`` times as long as
        usual; bins are at its pace then.
        """
        bins, outcomes, since = (
            self._hazards.bins,
            ready.outcomes,
            -math.inf if passage is None else passage.t,
        )
        camera = self.zones[zone].camera
        exposed = outcomes.exposure if passage is None else self._hazards.exposed(t - since)
        exposed = outcomes.exposed(exposed)
        prior = outcomes.hazard * bins.widths * exposed
        found = self._recent(t, since, zone)
        before = len(found)
        if elapsed:
            edges = paced(bins.edges, slower)
            came_since, remembered = self._since(t, elapsed, camera)
            found = np.concatenate((found, came_since))
            prior *= unknown(edges, elapsed, remembered, ready.later)
        else:
            prior = np.where(bins.edges[1:] <= -ready.later[:, None], 0.0, prior)
        mass: Floats = prior * np.array(self._alive(ready))[:, None]
        there, came = self._arrivals.zone[found], self._arrivals.t[found]
        self._row_of[outcomes.targets] = np.arange(len(outcomes.targets))
        k = self._row_of[there]
        self._row_of[outcomes.targets] = -1
        lag = came - t - np.where(k >= 0, outcomes.delay[k], 0.0)
        at = bins.index(paced(lag, 1.0 / slower) if elapsed else lag)
        some = np.flatnonzero((k >= 0) & (at >= 0))
        k, at, there, came, rate = (
            k[some],
            at[some],
            there[some],
            came[some],
            self._arrivals.rate[found[some]],
        )
        here = outcomes.hazard[k, at] * exposed[k, at]
        if elapsed:
            here *= (bins.widths / np.diff(edges))[at]
        if observed:
            rate = rate - self._hazards.rates_from(zone, there, came - t)
        if passage is not None:
            entered = self._hazards.rates_entered(passage.entry, there, came - since)
            own = entered if observed else entered + self._hazards.rates_ahead(camera, there)
            if elapsed:  # those who came after the exit: not from within the view, though it was not known any better
                in_view = some < before
                own = own * (
                    in_view if observed else self._camera_of[there] != self._camera_of[zone]
                )
                entered = entered * in_view
            here = here + entered
            rate = rate - own
        np.add.at(mass, (k, at), here / np.maximum(rate, RATE_MIN))
        return mass

    def _has_left(self, zone: int, t: float) -> bool:
        """Whether an exit there and then has been observed."""
        times, zones = self._exits.after(-math.inf)
        return bool(((times == t) & (zones == zone)).any())

    def _since(self, t: float, elapsed: float, camera: str) -> tuple[NDArray[np.intp], float]:
        """Arrivals (indices) from an exit until ``elapsed`` seconds after it, clocks taken as they
        are; and from how many seconds after it on they are remembered.
        """
        arrivals = self._arrivals
        first = arrivals.first
        zones = arrivals.zone[first : arrivals.stop]
        shown = arrivals.t[first : arrivals.stop] + (self._ahead_of[zones] - self._ahead[camera])
        remembered = float(shown[0]) - t if len(shown) >= RECENT_MAX else -math.inf
        return np.flatnonzero((shown >= t) & (shown <= t + elapsed)) + first, remembered

    def _recent(self, t: float, since: float, zone: int) -> NDArray[np.intp]:
        """Arrivals (indices, newest first) in other views from ``since`` on that were there by
        ``t``, clocks taken as they are, and could be the object leaving at ``zone`` at ``t``.
        """
        arrivals, targets = self._arrivals, self._hazards.seen_before(zone)
        first, oldest = arrivals.first, max(t + self._hazards.bins.lag_min, since)
        self._wanted[targets] = True
        found = np.flatnonzero(self._wanted[arrivals.zone[first : arrivals.stop]])[::-1] + first
        self._wanted[targets] = False
        if len(found):
            came = arrivals.t[found]
            later = self._ahead_of[arrivals.zone[found]] - self._ahead[self.zones[zone].camera]
            found = found[(came + later < t) & (came >= since) & (came >= oldest)]
            tied = found[arrivals.t[found] == since].tolist()
            gone = [row for row in tied if not self._in_view(int(arrivals.zone[row]), since, t)]
            found = found[~np.isin(found, gone)]
        return found

    def _share_causes(self, zone: int, t: float, passage: Passage | None) -> None:
        """Whoever has left is among the causes of what has come since elsewhere, but no longer as
        one in the view.
        """
        arrivals, bin_of = self._arrivals, self._hazards.bin_of
        counts, since = (
            arrivals.dropped + arrivals.first,
            -math.inf if passage is None else passage.t,
        )
        oldest = max(t + self._hazards.bins.lag_min, since)
        for _, target, later, earliest, ahead, _, hazard in self._ready.before(zone):
            in_view = 0.0 if passage is None else ahead
            reach = oldest if in_view else max(oldest, t + earliest)
            for came, number in reversed(arrivals.of_zone.get(target, ())):
                if came < reach:
                    break
                if came >= since and came + later < t and number >= counts:
                    arrivals.rate[number - arrivals.dropped] += (
                        hazard.get(bin_of(came - t), 0.0) - in_view
                    )

    def _in_view(self, zone: int, came: float, t: float) -> bool:
        """Whether somebody who came to a zone at ``came`` was still in the view at ``t``, seconds
        in right time.
        """
        camera = self.zones[zone].camera
        return self._under_way.was_in_view(camera, zone, came, t + self._ahead[camera])

    def _share_with_simultaneous(self, passage: Passage) -> None:
        """A passage that has just begun is among the causes of what came at the same instant
        elsewhere.
        """
        arrivals, hazards = self._arrivals, self._hazards
        for row in range(arrivals.stop - 1, arrivals.first - 1, -1):
            if arrivals.t[row] != passage.t:
                break
            target = int(arrivals.zone[row])
            if self.zones[target].camera != passage.camera:
                entered = hazards.rate_entered(passage.entry, target, 0.0)
                arrivals.rate[row] += hazards.rate_ahead(passage.camera, target) + entered

    def _causes(self, zone: int, t: float) -> dict[str, float]:
        """Rate (1/s) at which those who have left each camera and those still in its view could
        cause an arrival now.

        What comes from outside is not among them.
        """
        left, zones = self._exits.after(t - self._hazards.lag_max - self._clocks_apart)
        sources, rates = self._hazards.rates(zones, zone, t - left)
        total = np.bincount(self._camera_of.take(sources), rates)
        [some] = total.nonzero()
        names = map(self._names.__getitem__, some.tolist())
        causes: dict[str, float] = dict(zip(names, total.take(some).tolist(), strict=True))
        here, kernels, further = self.zones[zone].camera, self._hazards.kernels_to(zone), []
        for camera in self._hazards.cameras_ahead(zone):
            if camera == here:
                continue
            if not (passages := self._under_way.in_view(camera)):
                continue
            ahead, rate, first = (
                self._hazards.rate_ahead(camera, zone),
                causes.get(camera, 0.0),
                None,
            )
            for place, passage in passages:
                one = ahead
                if passage.entry in kernels:
                    one += self._hazards.rate_entered(passage.entry, zone, t - passage.t)
                if one:
                    rate += one
                    first = first or place
            if first is not None:
                further.append((first, camera, rate))
        causes.update(
            (camera, rate) for _, camera, rate in sorted(further)
        )  # as they came: sums depend on the order
        return causes

    def _alive(self, ready: Ready) -> list[float]:
        """Probability (targets,) that each camera still reports, from how many events of others it
        has let pass.
        """
        events, last_event, exp, most = self._events, self._last_event, math.exp, SILENCE_NATS_MAX
        return [
            1.0
            / (
                1.0
                + DEAD_PRIOR
                * exp(nats if (nats := (events - last_event[k]) * share) < most else most)
            )
            for k, share in zip(ready.cameras, ready.share, strict=True)
        ]


def _check(t: float, now: float | None) -> None:
    if now is not None and not t <= now < math.inf:
        raise ValueError(
            f"now is {now}: give the time of the exit, {t}, or a later one, in seconds"
        )
