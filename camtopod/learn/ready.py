"""What a prediction needs of the zone that an object leaves, as far as it depends on the topology version alone.

It is worked out when a zone is first asked about, not for all zones of a new version at once.
"""

from __future__ import annotations

import math
from collections.abc import Set
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.learn.hazards import Hazards, Outcomes
from camtopod.learn.lag_odds import quantiles, window
from camtopod.learn.pace import Paces
from camtopod.learn.slowness import LAG_SECONDS_MIN
from camtopod.records import Topology, Zone

Floats = NDArray[np.float64]
Pace = tuple[float, float] | None
"""As `Paces.of_passage` has it."""

MASS_MIN = 1e-200
"""Less has no quantiles, and is never among the answers."""


class Before(NamedTuple):
    """An outcome that may have come about before the exit: at another camera, whose views overlap."""

    number: int
    """Of the outcome."""
    target: int
    later: float
    """By how much its clock is ahead."""
    earliest: float
    """No arrival counts at lags below this, unless there is a kernel."""
    ahead: float
    """Rate (1/s) at which an object in the view appears there before it leaves."""
    kernels: Set[int]
    """Zones of entry from which objects are known to appear there."""


class Ready:
    """One zone; its outcomes are numbered as in `Outcomes`."""

    __slots__ = (
        *("outcomes", "targets", "later", "sure", "cameras", "share", "exposed"),
        *("_site", "_before", "_before_at", "_earliest", "_transitions", "_began", "_shift", "_windows"),
    )

    def __init__(self, site: ReadyZones, zone: int, outcomes: Outcomes) -> None:
        here, bins = site.zones[zone].camera, site.hazards.bins
        self._site, self.outcomes = site, outcomes
        self.targets = [site.zones[k] for k in outcomes.targets]
        self.later = np.array([site.ahead.get(target.camera, 0.0) - site.ahead[here] for target in self.targets])
        """By how much their clocks are ahead, (targets,)."""
        self.sure: Floats = 1.0 - outcomes.doubt
        self.cameras = site.camera_of[outcomes.targets]
        """Those of the targets, (targets,), and the shares of all events that are theirs, (targets,)."""
        self.share = site.share_of[outcomes.targets]
        began = np.searchsorted(bins.edges[1:], -self.later, "right")
        self._began = began if (began != began[0]).any() else int(began[0])
        past = int(site.hazards.past.sum())
        self.exposed = [
            k for k, first in enumerate(began.tolist()) if first < past and outcomes.hazard[k, first:past].any()
        ]
        """Those that may have come about before the exit without being known: how likely, the length of the passage
        says.
        """
        self._before = self._find_before(here)
        self._before_at = np.array([one.target for one in self._before], np.intp)
        self._earliest = np.array([-math.inf if one.kernels else one.earliest for one in self._before])
        self._transitions: Floats = outcomes.share * site.hazards.departures[zone]
        self._shift: Floats = np.where(site.corrected, 0.0, self.later)
        self._windows: dict[float | None, tuple[Floats, Floats]] = {}

    @property
    def coming(self) -> Floats:
        """Widths of the bins of lags of which nothing would be known at the exit, 0 for the others: (bins,) or
        (targets, bins).
        """
        widths: Floats = self._site.coming[self._began]
        return widths

    def before(self, t: float, since: float, newest: Floats) -> list[Before]:
        """Those that an exit at ``t`` after a passage since ``since`` may have had, as far as there have been arrivals:
        the newest in each zone came at ``newest`` (zones,).
        """
        came = newest[self._before_at] >= np.maximum(t + self._earliest, since)
        return [self._before[n] for n in came.nonzero()[0].tolist()]

    def exposure(self, at: int, stay: float | None) -> float:
        """Share of one bin of lags that a passage of ``stay`` seconds, None if unknown, is exposed to."""
        if stay is None:
            return self.outcomes.exposure.item(at)
        low, high = self._site.edges[at], self._site.edges[at + 1]
        return 1.0 if high > 0 else min(max((high + stay) / (high - low), 0.0), 1.0)

    def windows(self, numbers: list[int], pace: Pace, odds: Floats, changed: set[int]) -> list[list[float]]:
        """Time windows at the exit of the outcomes ``numbers``; ``odds`` (targets, bins) of those that are ``changed``
        are not the usual ones.
        """
        factor, wider = pace or (1.0, None)
        if wider not in self._windows:
            self._windows[wider] = self._usual(wider)
        scaled, fixed = self._windows[wider]
        usual = (np.rint((scaled * factor + fixed) * 1000.0) / 1000.0).tolist()
        return [
            self.window(k, pace, window(odds[k].tolist(), self._site.edges)) if k in changed else usual[k]
            for k in numbers
        ]

    def window(self, number: int, pace: Pace, lags: list[float]) -> list[float]:
        """That of one outcome from the `lag_odds.quantiles` of an object of usual pace."""
        shift, transitions = self._shift.item(number), self._transitions.item(number)
        return [round(lag + shift, 3) for lag in self._site.paces.at_pace(pace, transitions, *lags)]

    def _usual(self, wider: float | None) -> tuple[Floats, Floats]:
        """Windows of objects of usual pace: what scales with the pace and what does not, each (targets, 3)."""
        mass = self.outcomes.hazard * self.coming
        some = np.flatnonzero(mass.sum(axis=1) > MASS_MIN)
        scaled, fixed = [[0.0] * 3 for _ in mass], [[shift] * 3 for shift in self._shift.tolist()]
        for k, lags in zip(some.tolist(), quantiles(mass[some], self._site.hazards.bins.edges), strict=True):
            if wider is None or lags[1] <= LAG_SECONDS_MIN:
                fixed[k] = [lag + shift for lag, shift in zip(lags, fixed[k], strict=True)]
            else:
                scaled[k] = [*self._site.paces.at_pace((1.0, wider), self._transitions.item(k), *lags)]
        return np.array(scaled), np.array(fixed)

    def _find_before(self, here: str) -> list[Before]:
        hazards, found = self._site.hazards, []
        by_then = hazards.bins.edges[:-1] <= self._site.clocks_apart  # by clocks as they are it may be later than that
        possible = (self.outcomes.hazard > 0.0) & by_then
        some, first = np.any(possible, axis=1).tolist(), np.argmax(possible, axis=1).tolist()
        for k, (target, later) in enumerate(zip(self.outcomes.targets, self.later.tolist(), strict=True)):
            kernels = hazards.kernels_to(target)
            if (some[k] or kernels) and self.targets[k].camera != here:
                earliest = self._site.edges[max(first[k] - 1, 0)] if some[k] else math.inf
                ahead = hazards.rate_ahead(here, target)
                found.append(Before(k, target, later or 0.0, earliest, ahead, kernels))
        return found


class ReadyZones:
    """All zones of a topology version from which anybody is known to go anywhere."""

    def __init__(self, topology: Topology, hazards: Hazards, paces: Paces) -> None:
        self.zones: list[Zone] = topology.zones
        self.hazards, self.paces = hazards, paces
        self.corrected = topology.model is not None and topology.model.clocks_corrected
        self.ahead = {camera.id: camera.clock_offset for camera in topology.cameras}
        self.clocks_apart = max(self.ahead.values(), default=0.0) - min(self.ahead.values(), default=0.0)
        self.cameras = {camera: k for k, camera in enumerate(dict.fromkeys(zone.camera for zone in topology.zones))}
        """Numbers of those that have zones."""
        self.camera_of = np.array([self.cameras[zone.camera] for zone in self.zones], np.intp)
        share = {known.camera: known.share for known in (topology.model.cameras if topology.model else [])}
        self.share_of = np.array([share.get(zone.camera, 0.0) for zone in self.zones])
        bins = hazards.bins
        self.edges: list[float] = bins.edges.tolist()
        self.coming = np.triu(np.broadcast_to(bins.widths, (bins.size + 1, bins.size)))
        """Widths of all bins but the first 0, 1, ..., (bins + 1, bins)."""
        self._ready: dict[int, Ready] = {}

    def of(self, zone: int) -> Ready | None:
        """None where nobody is known to go anywhere."""
        ready = self._ready.get(zone)
        if ready is None and (outcomes := self.hazards.outcomes.get(zone)) is not None:
            ready = self._ready[zone] = Ready(self, zone, outcomes)
        return ready
