"""What a prediction needs of the zone that an object leaves, as far as it depends on the topology
version alone.

It is worked out when a zone is first asked about, not for all zones of a new version at once.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence, Set
from itertools import accumulate
from struct import Struct as Layout
from typing import NamedTuple

import numpy as np

from camtopod.arrays import Floats
from camtopod.predict.hazards import Hazards, Outcomes
from camtopod.predict.speed import Paces
from camtopod.predict.time_windows import quantiles, quantiles_beside
from camtopod.records import Topology, Zone
from camtopod.topology import LAG_SECONDS_MIN

Pace = tuple[float, float] | None
"""As `Paces.of_passage` has it."""

MASS_MIN = 1e-200
"""Less has no quantiles, and is never among the answers."""
_WINDOW = Layout("6d")
"""As lists of numbers they would take five times the memory, and no less time to read."""


class Before(NamedTuple):
    """A zone at which whoever leaves may have appeared before the exit: of another camera, whose
    views overlap.
    """

    number: int
    """Of the outcome; -1: none, only those who leave the view elsewhere appear there."""
    target: int
    later: float
    """By how much its clock is ahead."""
    earliest: float
    """No arrival counts at lags below this, unless there is a kernel."""
    ahead: float
    """Rate (1/s) at which an object in the view appears there before it leaves."""
    kernels: Set[int]
    """Zones of entry from which objects are known to appear there."""
    hazard: dict[int, float]
    """As of `Outcomes`, by bin, where there is any."""


class _Exposed(NamedTuple):
    """Odds of an outcome that may have come about before the exit without being known: how likely,
    the length of the passage says.
    """

    past: list[float]
    """(bins before the exit,)"""
    later: float


class AtExit(NamedTuple):
    """What is known of the outcomes at an exit, beside each other."""

    odds: list[float]
    """(targets,)"""
    alive: list[float]
    """Probability (targets,) that each camera still reports."""
    came: dict[int, dict[int, float]]
    """Of outcomes that arrivals may have been: bins of their lags, and the odds of each beside what
    is still to come.
    """
    stay: float | None
    """Seconds of the passage, if known."""


class Ready:
    """One zone; its outcomes are numbered as in `Outcomes`. They are few, and an exit comes when
    nothing of this has been used for a while: then lists are quicker than arrays.
    """

    __slots__ = (
        *("outcomes", "targets", "later", "sure", "doubt", "cameras", "share", "before", "usual"),
        *("_site", "_exposed", "_transitions", "_began", "_shift", "_windows", "_coming"),
    )

    def __init__(self, site: Site, zone: int, outcomes: Outcomes, before: list[Before]) -> None:
        here, bins = site.zones[zone].camera, site.hazards.bins
        self._site, self.outcomes = site, outcomes
        self.targets = [site.zones[k] for k in outcomes.targets]
        clocks = np.array(
            [site.ahead.get(target.camera, 0.0) - site.ahead[here] for target in self.targets]
        )
        self.later = clocks + outcomes.delay
        """Seconds to add to the lags of the bins, for clocks that are ahead and for long ways,
        (targets,).
        """
        self.doubt: list[float] = outcomes.doubt.tolist()
        self.sure = [1.0 - doubt for doubt in self.doubt]
        self.cameras: list[int] = site.camera_of[outcomes.targets].tolist()
        """Those of the targets, and the shares of all events that are theirs."""
        self.share: list[float] = site.share_of[outcomes.targets].tolist()
        began = np.searchsorted(bins.edges[1:], -self.later, "right")
        self._began = began if (began != began[0]).any() else int(began[0])
        mass = outcomes.hazard * self.coming
        past = len(site.past_edges) - 1
        early = np.flatnonzero(mass[:, :past].any(axis=1) & (outcomes.delay == 0.0)).tolist()
        self._exposed = {
            k: _Exposed(mass[k, :past].tolist(), float(mass[k, past:].sum())) for k in early
        }
        mass[early] *= outcomes.exposure
        self.usual: list[float] = mass.sum(axis=1).tolist()
        """Odds where nothing is known of the exit."""
        self.before = [one for one in before if one.number >= 0 and (one.hazard or one.kernels)]
        """Those that may have come about."""
        self._transitions: Floats = outcomes.share * site.hazards.departures[zone]
        self._shift: Floats = np.where(site.corrected, 0.0, clocks) + outcomes.delay
        self._windows: dict[float | None, bytes] = {}
        self._coming: dict[int, list[float]] = {}
        """Of outcomes that were asked for: odds below each edge of what is still to come, after a
        usual passage.
        """

    @property
    def coming(self) -> Floats:
        """Widths of the bins of lags of which nothing would be known at the exit, 0 for the others:
        (bins,) or (targets, bins).
        """
        widths: Floats = self._site.coming[self._began]
        return widths

    def odds(self, stay: float | None) -> list[float]:
        """Odds at the exit after a passage of ``stay`` seconds, where nobody has come anywhere."""
        if stay is None or not self._exposed:
            return self.usual
        odds, edges = self.usual.copy(), self._site.past_edges
        at = bisect_right(edges, -stay) - 1  # the bin in which the passage began
        share = (
            (edges[at + 1] + stay) / (edges[at + 1] - edges[at])
            if 0 <= at < len(edges) - 1
            else 0.0
        )
        for k, mass in self._exposed.items():
            odds[k] = mass.later + sum(mass.past[at + 1 :]) + (share and share * mass.past[at])
        return odds

    def exposure(self, at: int, stay: float | None) -> float:
        """Share of one bin of lags that a passage of ``stay`` seconds, None if unknown, is exposed
        to.
        """
        if stay is None:
            return self.outcomes.exposure.item(at)
        low, high = self._site.edges[at], self._site.edges[at + 1]
        return 1.0 if high > 0 else min(max((high + stay) / (high - low), 0.0), 1.0)

    def windows(self, numbers: list[int], pace: Pace, known: AtExit) -> list[Sequence[float]]:
        """Time windows at the exit of the outcomes ``numbers``."""
        factor, wider = pace or (1.0, None)
        if wider not in self._windows:
            self._windows[wider] = self._usual(wider)
        usual, read, floor = self._windows[wider], _WINDOW.unpack_from, math.floor
        times: list[Sequence[float]] = []
        for k in numbers:
            if k in known.came or k in self._exposed:
                times.append(self.window(k, pace, self._lags(k, known)))
            else:
                a, b, c, x, y, z = read(usual, k * _WINDOW.size)
                times.append(
                    (
                        floor(a * factor + x) / 1e3,
                        floor(b * factor + y) / 1e3,
                        floor(c * factor + z) / 1e3,
                    )
                )
        return times

    def window(self, number: int, pace: Pace, lags: list[float]) -> list[float]:
        """That of one outcome from the `lag_odds.quantiles` of an object of usual pace."""
        shift, transitions = self._shift.item(number), self._transitions.item(number)
        return [round(lag + shift, 3) for lag in self._site.paces.at_pace(pace, transitions, *lags)]

    def _usual(self, wider: float | None) -> bytes:
        """Windows of objects of usual pace, a `_WINDOW` for each target: three times what scales
        with the pace and three times what does not and one half, in milliseconds.
        """
        mass = self.outcomes.hazard * self.coming
        some = np.flatnonzero(mass.sum(axis=1) > MASS_MIN)
        scaled, fixed = np.zeros((len(mass), 3)), np.repeat(self._shift[:, None], 3, axis=1)
        for k, lags in zip(
            some.tolist(), quantiles(mass[some], self._site.hazards.bins.edges), strict=True
        ):
            if wider is None or lags[1] <= LAG_SECONDS_MIN:
                fixed[k] += lags
            else:
                scaled[k] = self._site.paces.at_pace((1.0, wider), self._transitions.item(k), *lags)
        return np.hstack((scaled * 1000.0, fixed * 1000.0 + 0.5)).tobytes()

    def _lags(self, number: int, known: AtExit) -> list[float]:
        """The `lag_odds.quantiles` of one outcome."""
        came, stay = (
            sorted(known.came.get(number, {}).items()),
            known.stay if number in self._exposed else None,
        )
        coming = self._coming.get(number)
        if coming is None or stay is not None:
            began = self._began if isinstance(self._began, int) else int(self._began[number])
            mass = self.outcomes.hazard[number] * self._site.coming[began]
            if number in self._exposed:
                mass *= self.outcomes.exposure if stay is None else self._site.hazards.exposed(stay)
            coming = [0.0, *accumulate(mass.tolist())]
        if stay is None:
            self._coming[number] = coming
        return quantiles_beside(coming, known.alive[number], came, self._site.edges)


class Site:
    """What the zones of a topology version have in common."""

    def __init__(self, topology: Topology, hazards: Hazards, paces: Paces) -> None:
        self.zones: list[Zone] = topology.zones
        self.hazards, self.paces = hazards, paces
        self.corrected = topology.model is not None and topology.model.clocks_corrected
        self.ahead = {camera.id: camera.clock_offset for camera in topology.cameras}
        self.clocks_apart = max(self.ahead.values(), default=0.0) - min(
            self.ahead.values(), default=0.0
        )
        self.cameras = {
            camera: k
            for k, camera in enumerate(dict.fromkeys(zone.camera for zone in topology.zones))
        }
        """Numbers of those that have zones."""
        self.camera_of = np.array([self.cameras[zone.camera] for zone in self.zones], np.intp)
        share = {
            known.camera: known.share
            for known in (topology.model.cameras if topology.model else [])
        }
        self.share_of = np.array([share.get(zone.camera, 0.0) for zone in self.zones])
        bins = hazards.bins
        self.edges: list[float] = bins.edges.tolist()
        self.past_edges = self.edges[: int(hazards.past.sum()) + 1]
        """Those of the bins of lags before the exit."""
        self.coming = np.triu(np.broadcast_to(bins.widths, (bins.size + 1, bins.size)))
        """Widths of all bins but the first 0, 1, ..., (bins + 1, bins)."""

    def before(self, zone: int) -> list[Before]:
        """Where whoever leaves there may have appeared before."""
        hazards, here, found = self.hazards, self.zones[zone].camera, []
        outcomes = hazards.outcomes.get(zone)
        number = (
            {} if outcomes is None else {target: k for k, target in enumerate(outcomes.targets)}
        )
        for target in hazards.seen_before(zone).tolist():
            there = self.zones[target].camera
            later, k, hazard = (
                self.ahead.get(there, 0.0) - self.ahead[here],
                number.get(target, -1),
                {},
            )
            if outcomes is not None and k >= 0:
                [some] = hazards.before(outcomes.hazard[k], later + outcomes.delay[k]).nonzero()
                hazard = dict(zip(some.tolist(), outcomes.hazard[k, some].tolist(), strict=True))
            earliest = self.edges[max(min(hazard) - 1, 0)] if hazard else math.inf
            kernels, ahead = hazards.kernels_to(target), hazards.rate_ahead(here, target)
            found.append(Before(k, target, later or 0.0, earliest, ahead, kernels, hazard))
        return found


class ReadyZones:
    """All zones of a topology version from which anybody is known to go anywhere. None of them
    refers to this, so that all are gone with the version: whoever predicts may have the collector
    look for circles next to never.
    """

    def __init__(self, site: Site) -> None:
        self._site = site
        self._ready: dict[int, Ready] = {}
        self._before: dict[int, list[Before]] = {}

    def of(self, zone: int) -> Ready | None:
        """None where nobody is known to go anywhere."""
        ready = self._ready.get(zone)
        if ready is None and (outcomes := self._site.hazards.outcomes.get(zone)) is not None:
            ready = self._ready[zone] = Ready(self._site, zone, outcomes, self.before(zone))
        return ready

    def before(self, zone: int) -> list[Before]:
        """As of `Site`."""
        before = self._before.get(zone)
        if before is None:
            before = self._before[zone] = self._site.before(zone)
        return before
