"""The hazards of a topology version, prepared for prediction: where and when objects appear next.

The *hazard* of a pair of zones is the rate at which an object that left the first appears at the
second, by lag. `Hazards` reads hazards from the model of a version, or from its links if it has no
model. It answers two kinds of questions: the possible next zones of an exit (`Hazards.outcomes`),
and the rates at which known objects cause an arrival: objects that have left a zone
(`rates_by_row`, `rates_from`) and objects that are still in an overlapping view (`rate_entered`, by
the time since their entry, and `rate_before_exit`, the mean over the passage).
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import (
    Bools,
    Floats,
    Indices,
    Ints,
    Rows,
    Singles,
    ranges,
)
from camtopod.predict.outcomes import FLOOR, Outcomes, with_paths
from camtopod.records import CameraPath, Link, Model, Onward, Topology
from camtopod.topology import (
    LAG_SCALE_SECONDS,
    LAG_STEP,
    LEAVE_FLOOR,
    UNKNOWN_DWELL_SECONDS,
    LagBins,
    masses_on_bins,
    smooth,
)

NORMAL_Q90 = 1.2816
"""0.9 quantile of the standard normal distribution."""


class Hazards:
    """All hazards of a topology version; zones are indices into ``topology.zones``.

    outcomes: targets and hazards by zone of departure; zones without targets are left out.
    """

    def __init__(self, topology: Topology) -> None:
        model = model_of(topology)
        index = {zone.id: k for k, zone in enumerate(topology.zones)}
        self.bins = LagBins(model.lag_min, model.lag_max, model.lag_scale, model.lag_step)
        self.past = self.bins.edges[1:] <= 0
        """(bins,) True for lags before the exit."""

        # Zones: arrivals, dwell times and departures.
        self.arrival_rate = [FLOOR] * len(index)
        """(zones,) rate of arrivals from outside at each zone, 1/s."""
        self.stay: list[list[float]] = [[] for _ in index]
        """(zones,) deciles of the dwell times, in seconds, of passages that end in each zone; empty
        if unknown.
        """
        self.departures = [0] * len(index)
        """(zones,) number of exits at each zone from which the hazards were learned."""
        for known in model.zones:
            self.departures[index[known.zone]] = known.departures
            self.arrival_rate[index[known.zone]] += known.arrival_rate
            self.stay[index[known.zone]] = known.stay

        # Hazards from zone to zone.
        if model.onward is None:
            self.outcomes = self._from_links([*topology.links, *(topology.weak_links or [])], index)
        else:
            self.outcomes = self._from_posterior(model.onward, index)
        if model.paths is not None:
            self._add_paths(topology, model.paths)
        self._tabulate(len(index))
        self.lag_max = self.bins.lag_max + float(self._delay.max(initial=0.0))
        """Longest lag with a bin, delays of long paths included, seconds."""

        # Entry kernels, and mean rates before the exit.
        self._entered: dict[int, dict[int, list[float]]] = {}
        for kernel in model.entered or []:
            hazard = masses_on_bins(kernel.hazard, self.bins) / self.bins.widths
            self._entered.setdefault(index[kernel.zone], {})[index[kernel.to]] = hazard.tolist()
        self._rate_before_exit = self._mean_rates_before_exit(topology)
        self._index_overlaps(topology)

    def rates_by_row(self, sources: Ints, target: int, lag: Floats) -> tuple[Rows, Rows, Floats]:
        """Return the hazards at which objects that left several zones appear at one zone.

        sources (n,): zones that the objects left.
        target: the zone.
        lag (n, seconds): time since each object has left.

        The results are columns (m,): which of the n sources, row in its `outcomes`, hazard (1/s).
        """
        is_source = self._is_source.get(target)
        if is_source is None:
            is_source = self._is_source[target] = np.zeros(self._zones, np.bool_)
            is_source[self.sources(target)] = True
        [some] = is_source.take(sources).nonzero()
        which, row = self._rows_of(sources.take(some), target)
        which = some.take(which)
        first = self._first_row.take(sources.take(which))
        return which, row - first, self._at(row, lag.take(which))

    def sources(self, target: int) -> list[int]:
        """Return the zones from which objects appear next at a zone."""
        return self._sources.get(target, [])

    def rates_from(self, source: int, targets: Ints, lag: Floats) -> Floats:
        """Return the hazards (n, 1/s) at which an object that left one zone appears at others.

        targets (n,), lag (n, seconds): zones, and the time since the object has left.
        """
        which, row = self._rows_of(source, targets)
        rates = self._at(row, lag.take(which))
        return np.bincount(which, rates, minlength=len(lag)).astype(float, copy=False)

    def rows_to(self, source: int, targets: Indices) -> tuple[Rows, Rows]:
        """Return which of the ``targets`` (n,) outcomes of a zone lead to, and their rows, (m,)."""
        which, row = self._rows_of(source, targets)
        return which, row - self._first_row[source]

    def rates_entered(self, entry: int, targets: Ints, elapsed: Floats) -> Floats:
        """Return `rate_entered` (n, 1/s) for several targets and times (n, s) since the entry."""
        if entry not in self._entered:
            return np.zeros(len(elapsed))
        pairs = zip(targets.tolist(), elapsed.tolist(), strict=True)
        return np.array([self.rate_entered(entry, target, seconds) for target, seconds in pairs])

    def rate_entered(self, entry: int, target: int, elapsed: float) -> float:
        """Return the rate (1/s) at which an object that is still in a view appears at a zone.

        entry: zone where the object entered the view, ``elapsed`` seconds ago.
        target: zone of another view.

        It is the entry kernel of the two zones at ``elapsed``.
        """
        row = self._entered.get(entry, {}).get(target)
        at = self.bins.bin_of(elapsed)
        if row is None or elapsed < 0.0 or at < 0:
            return 0.0
        return row[at]

    def rates_before_exit(self, camera: str, targets: Ints) -> Floats:
        """Return `rate_before_exit` (n, 1/s) for several targets (n,)."""
        return np.array([self.rate_before_exit(camera, target) for target in targets.tolist()])

    def rate_before_exit(self, camera: str, target: int) -> float:
        """Return the rate (1/s) at which an object in a camera's view appears at a zone.

        target: zone of another view.

        It is the mean over the object's passage, as the time of its exit is not known yet.
        """
        return self._rate_before_exit.get((camera, target), 0.0)

    def seen_before(self, zone: int) -> Bools:
        """Return a mask (zones,) of zones where objects may appear before they leave at ``zone``.

        These are zones of other cameras.
        """
        possible = np.zeros(len(self._seen_before), np.bool_)
        possible[self._seen_before[zone]] = True
        return possible

    def exposure_of_passage(self, dwell: float) -> Floats:
        """Return the exposure of one passage to each lag, (bins,).

        dwell (seconds): duration of the passage.

        It is the share of the bin that lies within the passage, and 1 after the exit.
        """
        begun = (self.bins.edges[1:] + dwell) / self.bins.widths
        return np.where(self.past, np.minimum(np.maximum(begun, 0.0), 1.0), 1.0)

    def _from_posterior(self, rows: list[Onward], index: dict[str, int]) -> dict[int, Outcomes]:
        """Return the outcomes by zone from the records of a model; ``index``: of zones by id."""
        outcomes = {}
        for row in rows:
            if not row.next_:
                continue
            zone = index[row.zone]
            mass = np.stack([masses_on_bins(outcome.hazard, self.bins) for outcome in row.next_])
            outcomes[zone] = Outcomes(
                targets=np.array([index[outcome.to] for outcome in row.next_]),
                share=np.array([outcome.share for outcome in row.next_]),
                leave=max(row.leave, FLOOR),
                hazard=(mass / self.bins.widths).astype(np.float32),
                exposure=self._exposure(zone),
                doubt=np.array([outcome.doubt for outcome in row.next_]),
                delay=np.array([outcome.hazard.delay for outcome in row.next_]),
                by_path=np.zeros(len(row.next_), np.bool_),
                missed=np.array([outcome.missed for outcome in row.next_]),
            )
        return outcomes

    def _from_links(self, links: list[Link], index: dict[str, int]) -> dict[int, Outcomes]:
        """Return the outcomes by zone from the histograms of links; ``index``: of zones by id."""
        # Links by their source.
        grouped: dict[int, list[Link]] = {}
        for link in links:
            if link.relation != "visible" and link.from_ in index and link.to in index:
                grouped.setdefault(index[link.from_], []).append(link)

        outcomes = {}
        for zone, out in grouped.items():
            # Distribution of the lags of each link.
            spread = smooth(np.stack([_counts(link, self.bins) for link in out]))[0]
            share = spread / np.maximum(spread.sum(axis=1, keepdims=True), 1e-300)

            # Hazard: expected arrivals per second, over the share of departures that is exposed.
            probability = np.array([link.probability for link in out])
            delay = np.array([link.histogram.delay if link.histogram else 0.0 for link in out])
            exposure = self._exposure(zone)
            exposed = np.where(delay[:, None] > 0.0, 1.0, exposure)
            hazard = probability[:, None] * share / (self.bins.widths * exposed)

            outcomes[zone] = Outcomes(
                targets=np.array([index[link.to] for link in out]),
                share=probability,
                leave=max(1.0 - float(probability.sum()), LEAVE_FLOOR),
                hazard=hazard.astype(np.float32),
                exposure=exposure,
                doubt=np.zeros(len(out)),
                delay=delay,
                by_path=np.zeros(len(out), np.bool_),
                missed=np.zeros(len(out), np.bool_),
            )
        return outcomes

    def _add_paths(self, topology: Topology, paths: list[CameraPath]) -> None:
        """Average the outcomes with the second opinion of a version (`with_paths`)."""
        zones = topology.zones
        linked: dict[str, float] = {}
        for link in topology.links:
            if link.relation != "visible":
                linked[link.from_] = linked.get(link.from_, 0.0) + link.probability
        by_camera: dict[str, list[CameraPath]] = {}
        for path in paths:
            by_camera.setdefault(path.from_, []).append(path)
        for k, zone in enumerate(zones):
            none = np.zeros(0)
            gone = Outcomes(
                np.zeros(0, np.intp),
                none,
                1.0,
                np.zeros((0, self.bins.size), np.float32),
                self._exposure(k),
                none,
                none,
                none > 0,
                none > 0,
            )
            first = self.outcomes.get(k, gone)
            mine = by_camera.get(zone.camera, []) + by_camera.get(zone.id, [])
            both = with_paths(first, linked.get(zone.id, 0.0), mine, zones, self.bins)
            if len(both.targets):
                self.outcomes[k] = both

    def _exposure(self, zone: int) -> Floats:
        """Return the share of the departures at a zone that are exposed to each lag, (bins,).

        For lags before the exit, it is the share of the passages that had begun by then; for lags
        after the exit, it is 1.
        """
        deciles = self.stay[zone]
        if not deciles:
            return np.ones(self.bins.size)
        begun = 1.0 - np.interp(-self.bins.centres, deciles, np.linspace(0.0, 1.0, len(deciles)))
        return np.where(self.past, np.clip(begun, 0.02, 1.0), 1.0)

    def _tabulate(self, zones: int) -> None:
        """Put all hazards into one table, with an index by pair of zones, for quick look-up.

        The last column is all zeros, for lags without a bin.
        """
        # The table; `outcomes` refer to its rows, so that hazards are kept once.
        number = [len(outcomes.targets) for outcomes in self.outcomes.values()]
        source = np.repeat(np.array([*self.outcomes], np.int64), number)
        target = np.zeros(len(source), np.int64)
        self._table: Singles = np.zeros((len(source), self.bins.size + 1), np.float32)
        self._delay, self._weight = np.zeros((2, len(source)))
        self._first_row = np.zeros(zones, np.intp)
        """(zones,) row of the table with the first outcome of each zone."""
        first = 0
        for zone, outcomes in self.outcomes.items():
            self._first_row[zone] = first
            rows = slice(first, first + len(outcomes.targets))
            target[rows] = outcomes.targets
            self._table[rows, :-1] = outcomes.hazard
            self._delay[rows] = outcomes.delay
            self._weight[rows] = outcomes.weight
            self.outcomes[zone] = outcomes._replace(hazard=self._table[rows, :-1])
            first = rows.stop

        # The index.
        self._zones = zones
        key = source * zones + target
        self._order = np.argsort(key, kind="stable")
        after_all = zones * zones
        self._pairs, self._pair_first, self._pair_rows = np.unique(
            np.append(key[self._order], after_all), return_index=True, return_counts=True
        )
        self._sources: dict[int, list[int]] = {}
        self._is_source: dict[int, Bools] = {}
        """By target that was asked for: mask (zones,) of its sources."""
        for zone, to in sorted({*zip(source.tolist(), target.tolist(), strict=True)}):
            self._sources.setdefault(to, []).append(zone)
        self._limits = np.array(self.bins.limits)

    def _rows_of(self, sources: Indices | int, targets: Indices | int) -> tuple[Rows, Rows]:
        """Return which of n pairs of zones the rows of the table are of, and these rows, (m,)."""
        key = np.multiply(sources, self._zones, dtype=np.int64) + targets
        pair = self._pairs.searchsorted(key)
        [some] = (self._pairs.take(pair) == key).nonzero()
        pair = pair.take(some)
        which, at = ranges(self._pair_first.take(pair), self._pair_rows.take(pair))
        return some.take(which), self._order.take(at)

    def _at(self, row: Rows, lag: Floats) -> Floats:
        """Return the weighted hazards (n, 1/s) of rows (n,) of the table at lags (n, seconds).

        In the flattened table, a lag before the first bin gets the last column of the row before
        (of the last row for the first one), and a lag after the last bin the last column of its own
        row; all are zero.
        """
        at = self._limits.searchsorted(lag - self._delay.take(row), "right")
        at += row * self._table.shape[1]
        at -= 1
        rates: Floats = self._table.take(at).astype(float) * self._weight.take(row)
        return rates

    def _mean_rates_before_exit(self, topology: Topology) -> dict[tuple[str, int], float]:
        """Return the values of `rate_before_exit` by (camera, target).

        Each is the expected number of appearances before the exit over the median dwell time,
        averaged over the zones of the camera by their exits.
        """
        exits: dict[str, int] = {}
        for zone in topology.zones:
            exits[zone.camera] = exits.get(zone.camera, 0) + zone.exits

        rates: dict[tuple[str, int], float] = {}
        for k, outcomes in self.outcomes.items():
            zone = topology.zones[k]
            deciles = self.stay[k]
            median = deciles[len(deciles) // 2] if deciles else UNKNOWN_DWELL_SECONDS
            share = zone.exits / max(exits[zone.camera], 1) / max(median, 1.0)
            mass = outcomes.hazard * self.bins.widths * outcomes.exposure
            expected = outcomes.weight * mass[:, self.past].sum(axis=1)
            expected[outcomes.delay > 0.0] = 0.0
            for target, number in zip(outcomes.targets.tolist(), expected.tolist(), strict=True):
                key = zone.camera, target
                rates[key] = rates.get(key, 0.0) + share * number
        return rates

    def _index_overlaps(self, topology: Topology) -> None:
        """Compute the tables behind `cameras_before` and `seen_before`."""
        # Targets by camera, and cameras by target.
        reached: dict[str, set[int]] = {}
        for (camera, target), rate in self._rate_before_exit.items():
            if rate:
                reached.setdefault(camera, set()).add(target)
        for entry, targets in self._entered.items():
            reached.setdefault(topology.zones[entry].camera, set()).update(targets)
        self.cameras_before: dict[int, list[str]] = {}
        """By target: cameras whose objects may appear there before they leave the view."""
        for camera, zones in reached.items():
            for target in sorted(zones):
                self.cameras_before.setdefault(target, []).append(camera)

        # For each zone, all targets of its camera, and its own targets that are possible before the
        # exit.
        offset = {camera.id: camera.clock_offset for camera in topology.cameras}
        offsets = np.array([offset.get(zone.camera, 0.0) for zone in topology.zones])
        self._seen_before: list[list[int]] = []
        for k, zone in enumerate(topology.zones):
            before = set(reached.get(zone.camera, ()))
            if k in self.outcomes:
                outcomes = self.outcomes[k]
                shift = offsets[outcomes.targets] - offsets[k] + outcomes.delay
                reported = self.bins.edges[:-1] < -shift[:, None]
                possible = np.any(reported & (outcomes.hazard > 0.0), axis=1)
                before.update(outcomes.targets[possible].tolist())
            elsewhere = [to for to in before if topology.zones[to].camera != zone.camera]
            self._seen_before.append(elsewhere)


def model_of(topology: Topology) -> Model:
    """Return the model of a topology; if it has none, an empty one for the lags of its links."""
    if topology.model is not None:
        return topology.model
    low = min((link.transit.q10 for link in topology.links), default=0.0)
    high = max((link.transit.q90 for link in topology.links), default=60.0)
    return Model(LAG_SCALE_SECONDS, LAG_STEP, min(2.0 * low, 0.0), max(2.0 * high, 1.0), [], [])


def _counts(link: Link, bins: LagBins) -> Floats:
    """Return the transitions of a link by lag (bins,); without histogram, normally distributed."""
    if link.histogram is not None:
        return masses_on_bins(link.histogram, bins)
    sd = max((link.transit.q90 - link.transit.q10) / (2 * NORMAL_Q90), 0.5)
    shape = np.exp(-0.5 * ((bins.centres - link.transit.q50) / sd) ** 2) * bins.widths
    return shape / max(float(shape.sum()), 1e-300) * link.transitions
