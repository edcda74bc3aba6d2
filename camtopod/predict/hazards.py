"""The hazards of a topology version, ready for prediction: where objects that leave a zone appear,
and when.

Read off the posterior that the version carries; where it carries none, off its links.
"""

from __future__ import annotations

from collections.abc import Iterable, Set
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Singles
from camtopod.cooperative import Pause, no_pause, unhurried
from camtopod.records import Link, Onward, Topology
from camtopod.topology import (
    LAG_SCALE_SECONDS,
    LAG_STEP,
    LEAVE_FLOOR,
    UNKNOWN_STAY_SECONDS,
    LagBins,
    on_bins,
    smooth,
)

EXPOSURE_MIN = 0.02
NORMAL_Q90 = 1.2816
LEAVE_MIN = 1e-6
"""Where every other outcome has become impossible an object has left."""


class Outcomes(NamedTuple):
    """Where objects that leave one zone appear next."""

    targets: list[int]
    share: Floats
    """(targets,) of the departures."""
    leave: float
    """Share of the departures not seen again."""
    hazard: Singles
    """(targets, bins) per second and exposed departure; a version says it to fewer digits."""
    exposure: Floats
    """(bins,) share of the departures here that are exposed."""
    doubt: Floats
    """(targets,) share of those seen there that may as well be chance."""
    delay: Floats
    """(targets,) seconds to add to the lags of the bins, for long ways."""

    def exposed(self, exposure: Floats) -> Floats:
        """Share (targets, bins) exposed, where it is ``exposure`` (bins,) of lags that count from
        the exit: what takes a long way always is.
        """
        return np.where(self.delay[:, None] > 0.0, 1.0, exposure)


class Hazards:
    """Hazards by zone index (the order of ``topology.zones``). ``pause`` is called often while they
    are made.
    """

    def __init__(self, topology: Topology, pause: Pause = no_pause) -> None:
        model = topology.model
        if model is None:
            self.bins = LagBins(*_lag_range(topology), LAG_SCALE_SECONDS, LAG_STEP)
        else:
            self.bins = LagBins(model.lag_min, model.lag_max, model.lag_scale, model.lag_step)
        self.past = self.bins.edges[1:] <= 0
        index = {zone.id: k for k, zone in enumerate(topology.zones)}
        self.arrival_rate = [1e-6] * len(index)
        """(zones,) arrivals per second from outside."""
        self.stay: list[list[float]] = [[] for _ in index]
        """(zones,) deciles of the seconds that passages leaving there have lasted; empty where
        unknown.
        """
        self.departures = [0] * len(index)
        """(zones,) exits in the window the hazards were learned from."""
        for known in model.zones if model else []:
            self.departures[index[known.zone]] = known.departures
            self.arrival_rate[index[known.zone]] += known.arrival_rate
            self.stay[index[known.zone]] = known.stay
        if model is None or model.onward is None:
            self.outcomes = self._from_links([*topology.links, *(topology.weak_links or [])], index)
        else:
            self.outcomes = self._from_posterior(unhurried(model.onward, pause), index)
        self._entered: dict[int, dict[int, list[float]]] = {}
        for kernel in unhurried((model and model.entered) or [], pause):
            hazard = on_bins(kernel.hazard, self.bins) / self.bins.widths
            self._entered.setdefault(index[kernel.zone], {})[index[kernel.to]] = hazard.tolist()
        every = list(self.outcomes.items())
        first_rows = np.cumsum([1, *(len(o.targets) for _, o in every)]).tolist()
        self._first_row: dict[int, int] = dict(zip(self.outcomes, first_rows, strict=False))
        # The last column is for lags without a bin.
        self._rows: Singles = np.zeros((first_rows[-1], self.bins.size + 1), np.float32)
        self._delay = np.zeros(first_rows[-1])  # of each row
        for zone, o in unhurried(every, pause):  # the same hazards, kept once
            rows = self._rows[self._first_row[zone] :][: len(o.targets), :-1]
            rows[:] = o.hazard
            self._delay[self._first_row[zone] :][: len(o.targets)] = o.delay
            self.outcomes[zone] = o._replace(hazard=rows)
        self.lag_max = self.bins.lag_max + float(self._delay.max())
        """Longest lag with a bin, seconds."""
        self._limits = np.array(self.bins.limits)
        self.bin_of = self.bins.bin_of
        """As of `LagBins`."""
        into: dict[int, list[tuple[int, int]]] = {}
        pairs = [(zone, target) for zone, outcomes in every for target in outcomes.targets]
        for row, (zone, target) in enumerate(unhurried(pairs, pause), start=1):
            into.setdefault(target, []).append((zone, row))
        self._into = {
            target: np.array(rows, np.int32).T for target, rows in unhurried(into.items(), pause)
        }
        """By target, its sources and their rows (2, sources); row 0, all zeros, is of the
        others.
        """
        self._row = np.zeros(len(index), np.int32)  # all 0 between calls
        self._ahead = self._mean_rates_ahead(topology, pause)
        self._index_before(topology, pause)

    def rates(
        self, sources: NDArray[np.int32], target: int, lag: Floats
    ) -> tuple[NDArray[np.int32], Floats]:
        """Hazards in 1/s from several zones (n,) to one at lags (n,) in seconds: those (m,) of the
        zones from which there are any, and theirs (m,).
        """
        if target not in self._into:
            return sources[:0], lag[:0]
        zones, rows = self._into[target]
        self._row[zones] = rows
        row = self._row.take(sources)
        self._row[zones] = 0
        [some] = row.nonzero()
        return sources.take(some), self._at(row.take(some), lag.take(some))

    def rates_from(self, source: int, targets: NDArray[np.int32], lag: Floats) -> Floats:
        """Hazards (n,) in 1/s from one zone to several (n,) at lags (n,) in seconds."""
        if source not in self.outcomes:
            return np.zeros(len(lag))
        all_targets, first = self.outcomes[source].targets, self._first_row[source]
        self._row[all_targets] = np.arange(first, first + len(all_targets))
        row = self._row.take(targets)
        self._row[all_targets] = 0
        return self._at(row, lag)

    def _at(self, row: NDArray[np.int32], lag: Floats) -> Floats:
        """Hazards (n,) of rows (n,) at lags (n,) in seconds. What is before the first bin is
        counted as -1, behind the last as one more: both are in the last column, of this row or the
        one before.
        """
        at = self._limits.searchsorted(lag - self._delay.take(row), "right")
        at += row * np.intp(self._rows.shape[1])
        at -= 1
        return self._rows.take(at).astype(float)

    def rates_entered(self, entry: int, targets: NDArray[np.int32], elapsed: Floats) -> Floats:
        """`rate_entered` for several zones (n,) and times (n,)."""
        if entry not in self._entered:
            return np.zeros(len(elapsed))
        pairs = zip(targets.tolist(), elapsed.tolist(), strict=True)
        return np.array([self.rate_entered(entry, target, seconds) for target, seconds in pairs])

    def rates_ahead(self, camera: str, targets: NDArray[np.int32]) -> Floats:
        """`rate_ahead` for several zones (n,)."""
        return np.array([self._ahead.get((camera, target), 0.0) for target in targets.tolist()])

    def exposed(self, stay: float) -> Floats:
        """Share (bins,) of each bin of lags that a passage of ``stay`` seconds is exposed to."""
        begun = np.clip((self.bins.edges[1:] + stay) / self.bins.widths, 0.0, 1.0)
        return np.where(self.past, begun, 1.0)

    def before(self, hazard: Singles, later: float | Floats) -> NDArray[np.bool_]:
        """In which bins (..., bins) objects of these hazards may have appeared by the time they
        leave, where the clock is ``later`` seconds ahead of the one where they do.
        """
        possible: NDArray[np.bool_] = (hazard > 0.0) & (self.bins.edges[:-1] < -later)
        return possible

    def seen_before(self, zone: int) -> NDArray[np.intp]:
        """Zones of other cameras where objects may appear before they leave at this one."""
        return self._before[zone]

    def cameras_ahead(self, target: int) -> list[str]:
        """Cameras from whose views objects may appear at a zone before they leave."""
        return self._cameras_ahead.get(target, [])

    def rate_entered(self, entry: int | None, target: int, elapsed: float) -> float:
        """Rate (1/s) at which an object that entered a view at zone ``entry`` (None: unknown)
        ``elapsed`` seconds ago and is still in it appears at another zone.
        """
        row = self._entered.get(entry, {}).get(target) if entry is not None else None
        return 0.0 if row is None or elapsed < 0.0 or (at := self.bin_of(elapsed)) < 0 else row[at]

    def kernels_to(self, target: int) -> Set[int]:
        """Zones of entry for which `rate_entered` knows something of the target."""
        return self._kernels_to.get(target, frozenset())

    def rate_ahead(self, camera: str, target: int) -> float:
        """Rate (1/s) at which an object in the view of a camera appears at a zone before it leaves
        the view.
        """
        return self._ahead.get((camera, target), 0.0)

    def longest_stay(self, zones: list[int]) -> float | None:
        """Longest passage known that left at one of the zones, seconds."""
        return max((self.stay[zone][-1] for zone in zones if self.stay[zone]), default=None)

    def _from_posterior(self, rows: Iterable[Onward], index: dict[str, int]) -> dict[int, Outcomes]:
        outcomes = {}
        for row in rows:
            if row.next_:
                mass = np.stack([on_bins(outcome.hazard, self.bins) for outcome in row.next_])
                hazard = (mass / self.bins.widths).astype(np.float32)
                share = np.array([outcome.share for outcome in row.next_])
                zone, targets = index[row.zone], [index[outcome.to] for outcome in row.next_]
                doubt = np.array([outcome.doubt for outcome in row.next_])
                delay = np.array([outcome.hazard.delay for outcome in row.next_])
                leave = max(row.leave, LEAVE_MIN)
                outcomes[zone] = Outcomes(
                    targets, share, leave, hazard, self._exposure(zone), doubt, delay
                )
        return outcomes

    def _from_links(self, links: list[Link], index: dict[str, int]) -> dict[int, Outcomes]:
        grouped: dict[int, list[Link]] = {}
        for link in links:
            if link.relation != "visible" and link.from_ in index and link.to in index:
                grouped.setdefault(index[link.from_], []).append(link)
        outcomes = {}
        for zone, out in grouped.items():
            exposure = self._exposure(zone)
            spread = smooth(np.stack([_counts(link, self.bins) for link in out]))[0]
            share = spread / np.maximum(spread.sum(axis=1, keepdims=True), 1e-300)
            probability = np.array([link.probability for link in out])[:, None]
            delay = np.array([link.histogram.delay if link.histogram else 0.0 for link in out])
            exposed = np.where(delay[:, None] > 0.0, 1.0, exposure)
            hazard = (probability * share / (self.bins.widths * exposed)).astype(np.float32)
            leave = max(1.0 - float(probability.sum()), LEAVE_FLOOR)
            targets = [index[link.to] for link in out]
            outcomes[zone] = Outcomes(
                targets, probability[:, 0], leave, hazard, exposure, np.zeros(len(out)), delay
            )
        return outcomes

    def _exposure(self, zone: int) -> Floats:
        """Share (bins,) of the passages leaving at the zone that had begun by the lag; 1 for lags
        after the exit.
        """
        stay = self.stay[zone]
        if not stay:
            return np.ones(self.bins.size)
        begun = 1.0 - np.interp(-self.bins.centres, stay, np.linspace(0.0, 1.0, len(stay)))
        return np.where(self.past, np.clip(begun, EXPOSURE_MIN, 1.0), 1.0)

    def _index_before(self, topology: Topology, pause: Pause) -> None:
        """For `seen_before` and `cameras_ahead`."""
        clock = {camera.id: camera.clock_offset for camera in topology.cameras}
        clocks = np.array([clock.get(zone.camera, 0.0) for zone in topology.zones])
        ahead: dict[str, set[int]] = {}
        for (camera, target), rate in self._ahead.items():
            if rate:
                ahead.setdefault(camera, set()).add(target)
        for entry, targets in self._entered.items():
            ahead.setdefault(topology.zones[entry].camera, set()).update(targets)
        self._kernels_to: dict[int, set[int]] = {}
        for entry, targets in self._entered.items():
            for target in targets:
                self._kernels_to.setdefault(target, set()).add(entry)
        self._cameras_ahead: dict[int, list[str]] = {}
        for camera, reached in ahead.items():
            for target in sorted(reached):
                self._cameras_ahead.setdefault(target, []).append(camera)
        self._before: list[NDArray[np.intp]] = []
        for k, zone in enumerate(unhurried(topology.zones, pause)):
            found = set(ahead.get(zone.camera, ()))
            if k in self.outcomes:
                out = self.outcomes[k]
                later = clocks[out.targets] - clocks[k] + out.delay
                possible = np.any(self.before(out.hazard, later[:, None]), axis=1)
                found.update(
                    target
                    for target, some in zip(out.targets, possible.tolist(), strict=True)
                    if some
                )
            others = [
                target for target in sorted(found) if topology.zones[target].camera != zone.camera
            ]
            self._before.append(np.array(others, np.intp))

    def _mean_rates_ahead(self, topology: Topology, pause: Pause) -> dict[tuple[str, int], float]:
        """Expected appearances before leaving over the time in view, weighed by where objects
        leave, by camera.
        """
        exits: dict[str, int] = {}
        for zone in topology.zones:
            exits[zone.camera] = exits.get(zone.camera, 0) + zone.exits
        rates: dict[tuple[str, int], float] = {}
        for k, outcomes in unhurried(self.outcomes.items(), pause):
            zone = topology.zones[k]
            stay = self.stay[k][len(self.stay[k]) // 2] if self.stay[k] else UNKNOWN_STAY_SECONDS
            share = zone.exits / max(exits[zone.camera], 1) / max(stay, 1.0)
            ahead = (outcomes.hazard * self.bins.widths * outcomes.exposure)[:, self.past].sum(
                axis=1
            )
            ahead[outcomes.delay > 0.0] = 0.0
            for target, expected in zip(outcomes.targets, ahead.tolist(), strict=True):
                key = zone.camera, target
                rates[key] = rates.get(key, 0.0) + share * expected
        return rates


def _lag_range(topology: Topology) -> tuple[float, float]:
    """Lags to look at when the topology does not say: what its links need."""
    low = min((link.transit.q10 for link in topology.links), default=0.0)
    high = max((link.transit.q90 for link in topology.links), default=60.0)
    return min(2.0 * low, 0.0), max(2.0 * high, 1.0)


def _counts(link: Link, bins: LagBins) -> Floats:
    """The link's histogram on the bins, (bins,); one without is spread as its quantiles say."""
    if link.histogram is not None:
        return on_bins(link.histogram, bins)
    sd = max((link.transit.q90 - link.transit.q10) / (2 * NORMAL_Q90), 0.5)
    shape = np.exp(-0.5 * ((bins.centres - link.transit.q50) / sd) ** 2) * bins.widths
    return shape / max(float(shape.sum()), 1e-300) * link.transitions
