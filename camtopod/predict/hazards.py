"""The hazards of a topology version, prepared for prediction: where and when objects appear next.

The *hazard* of a pair of zones is the rate at which an object that left the first appears at the
second, by lag. `Hazards` reads hazards from the model of a version, or from its links if it has no
model. It answers two kinds of questions: the possible next zones of an exit (`Hazards.outcomes`),
and the rates at which objects cause an arrival, those that have left a zone (`rates_by_row`,
`rates_from`) and those that are still in an overlapping view (`rates_entered`, by the time since
their entry, and `rates_before_exit`, the mean over the passage).

All outcomes are rows of one table (`outcomes.Table`). The rows of a zone are prepared with the
first exit from it, as a version may be replaced before most zones have one.
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Bools, Floats, Indices, Ints, Rows, ranges
from camtopod.columns import numbers
from camtopod.predict.outcomes import FLOOR, Outcomes, exposures, of_links, of_posterior
from camtopod.predict.second_opinion import with_paths
from camtopod.records import Model, Topology
from camtopod.topology import (
    LAG_SCALE_SECONDS,
    LAG_STEP,
    STAY_DECILES,
    UNKNOWN_DWELL_SECONDS,
    LagBins,
    masses_of,
)


class Hazards:
    """All hazards of a topology version; zones are indices into ``topology.zones``."""

    def __init__(self, topology: Topology) -> None:
        model = model_of(topology)
        zones = len(topology.zones)
        self.bins = LagBins(model.lag_min, model.lag_max, model.lag_scale, model.lag_step)
        self.past = self.bins.edges[1:] <= 0
        """(bins,) True for lags before the exit."""

        # Cameras that have zones, and their clocks.
        self.cameras = list(dict.fromkeys(zone.camera for zone in topology.zones))
        camera = {name: k for k, name in enumerate(self.cameras)}
        self.camera_of = np.array([camera[zone.camera] for zone in topology.zones], np.intp)
        """(zones,) number of each zone's camera."""
        offset = {record.id: record.clock_offset for record in topology.cameras}
        self.offset_of = np.array([offset.get(zone.camera, 0.0) for zone in topology.zones])
        """(zones, seconds) clock offset of each zone's camera."""

        # Zones: arrivals, dwell times and departures.
        self.unexplained_rate = numbers(model.arrival_rate, np.float32, zones).astype(float)
        """(zones,) rate of arrivals that no departure explains, 1/s."""
        self.arrival_rate = self.unexplained_rate + FLOOR
        """(zones,) the same, never 0."""
        self.stay = numbers(model.stay, np.float32, zones, STAY_DECILES)
        """(zones, 11) deciles of the dwell times, in seconds, of passages that end in each zone; 0
        if unknown.
        """
        self.departures = numbers(model.departures, np.int32, zones)
        """(zones,) number of exits at each zone from which the hazards were learned."""
        self._exposure = exposures(self.stay, self.bins)

        # Hazards from zone to zone.
        if model.onward is None:
            self.table = of_links(topology, self.bins, self._exposure)
        else:
            self.table = of_posterior(model.onward, zones, self.bins)
        if model.paths is not None:
            self.table = with_paths(self.table, topology, model.paths, self.bins, self._exposure)
        self._index(zones)
        self.lag_max = self.bins.lag_max + float(self.table.delay.max(initial=0.0))
        """Longest lag with a bin, delays of long paths included, seconds."""

        # Entry kernels, and mean rates before the exit.
        entry = to = np.zeros(0, np.int32)
        kernels = np.zeros((0, self.bins.size))
        if model.entered is not None:
            entry = numbers(model.entered.zone, np.int32, -1)
            to = numbers(model.entered.to, np.int32, len(entry))
            kernels = masses_of(model.entered.hazard, self.bins) / self.bins.widths
        order = np.argsort(entry.astype(np.int64) * zones + to, kind="stable")
        order = order[self.camera_of[entry[order]] != self.camera_of[to[order]]]
        self._entry, self._entry_to = entry[order], to[order]
        """(kernels,) zones of entry, and targets, sorted by both."""
        self._entry_pairs = np.append(self._entry.astype(np.int64) * zones + self._entry_to, -1)
        """(kernels + 1,) entry * zones + target, sorted, with -1 as the last."""
        self._entry_kernels = np.zeros((len(order) + 1, self.bins.size + 1))
        """(kernels + 1, bins + 1) hazards by lag bin, 1/s; those of no kernel, or bin, are 0."""
        self._entry_kernels[:-1, :-1] = kernels[order]
        self._before = self._rates_before_exit(topology)
        """Pairs (n + 1,) of target and camera, as target * cameras + camera, sorted, with -1 as the
        last; and their values of `rates_before_exit` (n + 1,).
        """
        self._cameras_before: dict[int, list[int]] = {}
        """By target that was asked for: `cameras_before`."""
        self._seen_before: dict[int, Bools] = {}
        """By zone that was asked for: `seen_before`."""

    def outcomes(self, zone: int) -> Outcomes | None:
        """Return the possible next appearances of objects that leave a zone; None if none are."""
        rows = slice(*self._first_row[zone : zone + 2].tolist())
        if rows.start == rows.stop:
            return None
        return self.table.outcomes(zone, rows, self._exposure[zone])

    def leaving(self) -> tuple[Floats, Floats, Floats]:
        """Return the share (zones,) of the departures after which objects leave, by each opinion.

        Transitions that may be spurious are included. The third result is the weight of the second
        opinion.
        """
        t, zones = self.table, self._zones
        spurious = np.bincount(t.source, t.share * t.doubt, minlength=zones)
        seen_again = np.diff(self._first_row) > 0
        leave, by_paths = (
            np.where(seen_again, share, 1.0) for share in (t.leave + spurious, t.leave_by_paths)
        )
        return leave, by_paths, np.where(seen_again, t.paths_weight, 0.0)

    def rates_by_row(self, sources: Ints, target: int, lag: Floats) -> tuple[Rows, Rows, Floats]:
        """Return the hazards at which objects that left several zones appear at one zone.

        sources (n,): zones that the objects left.
        target: the zone.
        lag (n, seconds): time since each object has left.

        The results are columns (m,): which of the n sources, row in its `outcomes`, hazard (1/s).
        """
        [hits] = self.is_source(np.array([target])).take(sources).nonzero()
        index, row = self._rows_of(sources.take(hits), target)
        index = hits.take(index)
        first = self._first_row.take(sources.take(index))
        return index, row - first, self._at(row, lag.take(index))

    def is_source(self, targets: Ints) -> Bools:
        """Return a mask (zones,) of the zones from which objects appear next at any of some."""
        masks = []
        for target in dict.fromkeys(targets.tolist()):
            if target not in self._is_source:
                self._is_source[target] = np.zeros(self._zones, np.bool_)
                self._is_source[target][self.sources(target)] = True
            masks.append(self._is_source[target])
        mask: Bools = np.logical_or.reduce(masks)
        return mask

    def sources(self, target: int) -> list[int]:
        """Return the zones from which objects appear next at a zone."""
        if target not in self._sources:
            self._sources[target] = np.unique(
                self.table.source[self.table.target == target]
            ).tolist()
        return self._sources[target]

    def rates_from(self, sources: Indices | int, targets: Indices, lag: Floats) -> Floats:
        """Return the hazards (n, 1/s) at which objects that left zones appear at others.

        sources, targets (n,), lag (n, seconds): zones, and the time since the object has left; or
            other shapes that broadcast to that of ``lag``.
        """
        index, row = self._rows_of(sources, targets)
        rates = np.bincount(index, self._at(row, lag.reshape(-1).take(index)), minlength=lag.size)
        return rates.astype(float, copy=False).reshape(lag.shape)

    def rows_to(self, source: int, targets: Indices) -> tuple[Rows, Rows]:
        """Return which of the ``targets`` (n,) outcomes of a zone lead to, and their rows, (m,)."""
        index, row = self._rows_of(source, targets)
        return index, row - self._first_row[source]

    def rates_entered(
        self, entries: Indices | int, targets: Indices | int, elapsed: Floats
    ) -> Floats:
        """Return the rates (n, 1/s) at which objects that are still in a view appear at zones.

        entries (n,), elapsed (n, seconds): zones where they entered the view, and time since then.
        targets (n,): zones of other views; of its own, and before the entry, the rate is 0.

        It is the entry kernel of the two zones at ``elapsed``.
        """
        if not len(self._entry):
            return np.zeros(elapsed.shape)
        key = np.multiply(entries, self._zones, dtype=np.int64) + targets
        row = self._entry_pairs[:-1].searchsorted(key)
        row = np.where(self._entry_pairs.take(row) == key, row, -1)
        at = self._limits.searchsorted(elapsed, "right") - 1  # -1, and beyond the last bin, is 0
        rates: Floats = self._entry_kernels[row, np.where(elapsed >= 0.0, at, -1)]
        return rates

    def rates_before_exit(self, cameras: Indices, targets: Indices) -> Floats:
        """Return the rates (n, 1/s) at which objects in cameras' views appear at zones.

        cameras, targets (n,): numbers of the cameras, and zones of other views.

        It is the mean over an object's passage, as the time of its exit is not known yet.
        """
        key = np.multiply(targets, len(self.cameras), dtype=np.int64) + cameras
        pairs, rate = self._before
        at = pairs[:-1].searchsorted(key)
        rates: Floats = np.where(pairs.take(at) == key, rate.take(at), 0.0)
        return rates

    def cameras_before(self, targets: Ints) -> list[int]:
        """Return the cameras (numbers) whose objects may appear at any of some zones of others
        before they leave.
        """
        cameras: dict[int, None] = {}
        for target in dict.fromkeys(targets.tolist()):
            if target not in self._cameras_before:
                of_entries = self.camera_of[self._entry[self._entry_to == target]]
                pairs, first = self._before[0][:-1], target * len(self.cameras)
                rows = slice(*pairs.searchsorted([first, first + len(self.cameras)]).tolist())
                self._cameras_before[target] = [
                    *of_entries.tolist(),
                    *(pairs[rows] - first).tolist(),
                ]
            cameras |= dict.fromkeys(self._cameras_before[target])
        return [*cameras]

    def seen_before(self, zone: int) -> Bools:
        """Return a mask (zones,) of zones where objects may appear before they leave at ``zone``.

        These are zones of other cameras: all targets of the view, and those of the zone whose
        arrivals may be reported before the exit.
        """
        if zone not in self._seen_before:
            t = self.table
            rows = slice(*self._first_row[zone : zone + 2].tolist())
            shift = self.offset_of[t.target[rows]] - self.offset_of[zone] + t.delay[rows]
            before_exit = self.bins.edges[:-1] < -shift[:, None]
            early = np.any(before_exit & (t.hazard[rows, :-1] > 0.0), axis=1)
            possible = np.zeros(self._zones, np.bool_)
            camera = self.camera_of[zone]
            targets, cameras = np.divmod(self._before[0][:-1], len(self.cameras))
            possible[targets[cameras == camera]] = True
            possible[self._entry_to[self.camera_of[self._entry] == camera]] = True
            possible[t.target[rows][early]] = True
            possible[self.camera_of == camera] = False
            self._seen_before[zone] = possible
        return self._seen_before[zone]

    def exposure_of_passage(self, dwell: float) -> Floats:
        """Return the exposure of one passage to each lag, (bins,).

        dwell (seconds): duration of the passage.

        It is the share of the bin that lies within the passage, and 1 after the exit.
        """
        part = (self.bins.edges[1:] + dwell) / self.bins.widths
        return np.where(self.past, np.minimum(np.maximum(part, 0.0), 1.0), 1.0)

    def _index(self, zones: int) -> None:
        """Index the table by zone, and by pair of zones, for quick look-up."""
        self._zones = zones
        self._first_row = self.table.source.searchsorted(np.arange(zones + 1))
        """(zones + 1,) row of the table with the first outcome of each zone."""
        self._weight = self.table.weight
        key = self.table.source * zones + self.table.target
        self._order = np.argsort(key, kind="stable")
        after_all = zones * zones
        self._pairs, self._pair_first, self._pair_rows = np.unique(
            np.append(key[self._order], after_all), return_index=True, return_counts=True
        )
        self._sources: dict[int, list[int]] = {}
        """By target that was asked for: its sources."""
        self._is_source: dict[int, Bools] = {}
        """By target that was asked for: mask (zones,) of its sources."""
        self._limits = np.array(self.bins.limits)

    def _rows_of(self, sources: Indices | int, targets: Indices | int) -> tuple[Rows, Rows]:
        """Return which of n pairs of zones the rows of the table are of, and these rows, (m,).

        sources, targets: of any shapes that broadcast; pairs are counted along the result.
        """
        key = (np.multiply(sources, self._zones, dtype=np.int64) + targets).reshape(-1)
        pair = self._pairs.searchsorted(key)
        [hits] = (self._pairs.take(pair) == key).nonzero()
        pair = pair.take(hits)
        index, at = ranges(self._pair_first.take(pair), self._pair_rows.take(pair))
        return hits.take(index), self._order.take(at)

    def _at(self, row: Rows, lag: Floats) -> Floats:
        """Return the weighted hazards (n, 1/s) of rows (n,) of the table at lags (n, seconds).

        In the flattened table, a lag before the first bin gets the last column of the row before
        (of the last row for the first one), and a lag after the last bin the last column of its own
        row; all are zero.
        """
        at = self._limits.searchsorted(lag - self.table.delay.take(row), "right")
        at += row * self.table.hazard.shape[1]
        at -= 1
        rates: Floats = self.table.hazard.take(at).astype(float) * self._weight.take(row)
        return rates

    def _rates_before_exit(self, topology: Topology) -> tuple[Rows, Floats]:
        """Return the pairs and values of `rates_before_exit` above 0, and one that is no pair.

        Each is the expected number of appearances before the exit over the median dwell time,
        averaged over the zones of the camera by their exits.
        """
        # Expected appearances before the exit, by row.
        t, past = self.table, int(self.past.sum())
        mass = (self._exposure[:, :past] * self.bins.widths[:past]).astype(np.float32)
        expected = self._weight * np.einsum("rb,rb->r", t.hazard[:, :past], mass[t.source])
        is_own = self.camera_of[t.source] == self.camera_of[t.target]
        expected[is_own | (t.delay > 0.0)] = 0.0

        # By camera and target, each zone with its share of the exits.
        exits = np.array([zone.exits for zone in topology.zones], float)
        of_camera = np.bincount(self.camera_of, exits)[self.camera_of]
        has_median, median = self.stay.any(axis=1), self.stay[:, STAY_DECILES // 2]
        median = np.where(has_median, median, UNKNOWN_DWELL_SECONDS)
        expected *= (exits / np.maximum(of_camera, 1.0) / np.maximum(median, 1.0))[t.source]
        key = t.target * len(self.cameras) + self.camera_of[t.source]
        pair, of_pair = np.unique(key, return_inverse=True)
        rate = np.bincount(of_pair, expected).astype(float, copy=False)
        hits = np.flatnonzero(rate)
        return np.append(pair[hits], -1), np.append(rate[hits], 0.0)


def model_of(topology: Topology) -> Model:
    """Return the model of a topology; if it has none, an empty one for the lags of its links."""
    if topology.model is not None:
        return topology.model
    low = min((link.transit.q10 for link in topology.links), default=0.0)
    high = max((link.transit.q90 for link in topology.links), default=60.0)
    return Model(LAG_SCALE_SECONDS, LAG_STEP, min(2.0 * low, 0.0), max(2.0 * high, 1.0), b"")
