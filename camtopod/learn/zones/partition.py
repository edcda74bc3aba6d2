"""Partition of a camera's grid cells into zones and clutter: a robust DaSpec (thesis 4.2).

The input are the occupied cells of a camera's grid, with the sums of their events (`Cells`); the
result of `partition` is the zone of each cell, or clutter. Cells that clutter alone explains are
left out (`clutter`), DaSpec groups the others (`daspec`), and *moves* (`_Partition.improve`) merge,
drop, reassign and split groups until none improves the partition.

Two groups are two zones if two Gaussians explain them better than one (`marginal_likelihood`) and
there is a valley, a stretch of low density, between them (`separation`). The first criterion alone
would cut every zone that is not Gaussian; the second alone is weak for few events. A partition may
also start from an earlier one, which then changes only on clear evidence (`HOLD`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from camtopod.arrays import Floats
from camtopod.learn.zones.cells import Cells
from camtopod.learn.zones.clutter import (
    ROUNDS_MAX,
    Labels,
    daspec_groups,
    dense_cells,
)
from camtopod.learn.zones.daspec import POINTS_NEAR_MIN
from camtopod.learn.zones.marginal_likelihood import (
    covariance,
    log_zone,
    log_zones,
    moments,
)
from camtopod.learn.zones.mixture import CELL_X, CELL_Y
from camtopod.learn.zones.separation import valley_between
from camtopod.learn.zones.ways import CELL_SPREAD, WAY_CONTRAST, way_contrast
from camtopod.topology import GRID_COLUMNS, GRID_ROWS

ZONE_EVENTS_MIN = 3
"""Least number of events of a zone if a camera has several. Where there is hardly any clutter, two
events are unlikely to coincide by chance, but two points have no extent in the second dimension.
"""
PAIR_EVENTS = 1000.0
"""Limit of the number of events that a pair of groups counts for when it is split or merged. No
zone is exactly Gaussian, so with unlimited evidence every zone would be split. n events count as n
/ (1 + n / PAIR_EVENTS) (Miller, Dunson: Robust Bayesian inference via coarsening, JASA 2019).
"""
VALLEY_MIN = 3.5
"""Least log likelihood ratio of a valley if two Gaussians explain the events better than one."""
VALLEY_ALONE = 8.0
"""Least log likelihood ratio of a valley if two Gaussians do not explain the events better. Several
doors in a row need it: however they are cut in two, the two parts look like one Gaussian.
"""
UNLIKE_GAIN_PER_EVENT = 2.0
"""Gain of log posterior per event of the smaller group above which no valley is needed."""
EXCESS_MIN = 11.0
"""Log likelihood ratio of the events beyond the expected clutter above which a group is a zone,
even if its Gaussian fits badly. An example is a fire door, if half of the events in its cells are
clutter.
"""
HOLD = 1.5
"""Factor on the thresholds of evidence when an earlier partition is held. A new zone needs this
many times the usual evidence, and a held zone is dropped only if its evidence is this many times
smaller than a new zone would need. So zones do not come and go.
"""
_CORE = 1.6
"""Radius of the densest place of a group, grid steps."""
_DIRECTIONS = np.array([(np.cos(angle), np.sin(angle)) for angle in np.arange(6) * np.pi / 6])
"""Unit vectors (x, y) perpendicular to the cuts of groups."""


def partition(
    cells: Cells, count: NDArray[np.int64], rates: Floats, start: Labels | None = None
) -> Labels:
    """Return the zone of each occupied cell (m,), counted from 0, or -1 for clutter.

    cells: the occupied cells.
    count (rows, columns): number of events of each cell of the grid.
    rates (rows, columns): expected events of clutter in each cell (`clutter_rates`).
    start (m,): an earlier partition, which is changed only where the evidence is clear (`HOLD`);
        None to start from nothing.
    """
    one_zone = np.zeros(len(cells.index), dtype=np.intp)
    if count.sum() < POINTS_NEAR_MIN:
        return one_zone

    labels = _Partition(cells, one_zone - 1 if start is None else start, rates).improve()
    return labels if labels.max() >= 0 else one_zone


class _Partition:
    """A partition of the m occupied cells into K groups and clutter, improved by moves.

    labels (m,): group of each cell, -1 for clutter.
    zones (K, 6): sums of each group's events, as in `Cells`.
    mean (2, K), scatter (3, K), cov (3, K): of each group (`moments`, `covariance`).
    clutter: number of events outside all groups.
    as_clutter (K,): log likelihood of each group's events under the density of clutter.
    density (cells of the grid,): expected clutter in each cell over its mean.
    hold: `HOLD` if the first partition is held, else 1.
    valleys: cached results of `_valley_between`, by the sums of the two groups.
    whole_zones: sums of groups that could not be split.
    contrasts: cached results of `_contrast`, by the sums of the group.
    """

    def __init__(self, cells: Cells, labels: Labels, rates: Floats) -> None:
        self.cells = cells
        self.hold = HOLD if labels.max() >= 0 else 1.0
        self.rates = rates

        # Density of clutter relative to a uniform one.
        self.density = (rates / rates.mean()).ravel()
        self.log_density = np.log(self.density[cells.index])

        # For each cell of the grid the density of clutter, and the events.
        self.grids = np.zeros((len(self.density), 2))
        self.grids[:, 0] = self.density
        self.grids[cells.index, 1] = cells.sums[0]
        self.log_mass = cells.sums[0] * self.log_density

        self.total = float(cells.sums[0].sum())
        self.valleys: dict[bytes, float] = {}
        self.whole_zones: set[bytes] = set()
        self.contrasts: dict[bytes, float] = {}
        self._set(labels)

    def _set(self, labels: Labels) -> None:
        """Replace the partition by ``labels`` (m,), and compute the statistics of its groups."""
        # Number the groups that have cells from 0.
        present = np.bincount(labels + 1, minlength=1) > 0
        present[0] = False
        numbers = np.cumsum(present) - 1
        numbers[0] = -1
        self.labels = numbers[labels + 1]

        # Statistics. Sums of positions in fixed point are exact, in whatever order they are added.
        self.zones = (self.labels == np.arange(numbers[-1] + 1)[:, None]).astype(
            np.float64
        ) @ self.cells.sums.T
        self.mean, self.scatter = moments(self.zones.T)
        self.cov = covariance(self.zones[:, 0], self.scatter)
        self.as_clutter = np.bincount(self.labels + 1, self.log_mass, len(self.zones) + 1)[1:]
        self.clutter = self.total - float(self.zones[:, 0].sum())

    def improve(self) -> Labels:
        """Move until no move improves the partition, at most `ROUNDS_MAX` rounds; return it."""
        is_held = len(self.zones) > 0
        if not is_held:
            self._find()
        for _ in range(ROUNDS_MAX):
            self._merge()
            self._drop()
            if self._assign():
                self._assign()
            if not self._split() and not self._drop_ways() and not (is_held and self._find()):
                return self.labels
        self._merge()
        self._drop()
        self._drop_ways()
        return self.labels

    def _find(self) -> bool:
        """Add the DaSpec groups of the cells outside all groups; return True if there are any.

        If there are zones, only groups that stand out from clutter clearly are added.
        """
        # The cells outside that stand out; at the start, where none does, all of them.
        outside = self.labels < 0
        count = np.zeros(self.rates.shape)
        count.flat[self.cells.index[outside]] = self.cells.sums[0, outside]
        zone_count = len(self.zones)
        dense = dense_cells(count, self.rates)
        if not dense.any():
            if zone_count:
                return False
            dense = count

        # Add their groups, and remove those that are not zones.
        groups = daspec_groups(dense)[self.cells.index]
        self._set(np.where(groups >= 0, groups + zone_count, self.labels))
        for k in range(len(self.zones) - 1, zone_count - 1, -1) if zone_count else ():
            if (
                self.zones[k, 0] < ZONE_EVENTS_MIN
                or self._drop_gain(np.array([k]), self.hold)[0] >= 0
                or self._contrast(k) < WAY_CONTRAST * self.hold
                or self._is_tail(k)
            ):
                self._remove(k)
        return len(self.zones) > zone_count

    def _is_tail(self, k: int) -> bool:
        """Return True if there is no valley between zone ``k`` and some bigger zone.

        Then the events of zone ``k`` are a heavy tail of the bigger zone, however far away it is.
        """
        larger_zones = np.flatnonzero(self.zones[:, 0] > self.zones[k, 0])
        return any(
            self._valley_between(
                self.zones[j], self.zones[k], (self.labels == j) | (self.labels == k)
            )
            < VALLEY_MIN
            for j in larger_zones
        )

    def _join(self, a: int, b: int) -> None:
        """Merge group ``b`` into group ``a``."""
        self._set(np.where(self.labels == b, a, self.labels))

    def _remove(self, k: int) -> None:
        """Turn group ``k`` into clutter."""
        self._set(np.where(self.labels == k, -1, self.labels))

    def _merge(self) -> None:
        """Merge pairs of groups that are not two zones, the most similar pair first.

        The smaller group becomes clutter instead if the log posterior is then higher.
        """
        while len(self.zones) > 1:
            # Gain of log posterior of every pair by being two zones instead of one.
            zones = np.arange(len(self.zones))
            a, b = np.nonzero(zones[:, None] < zones)
            two = np.stack((a, b))
            joint_sums = self.zones.T[:, two].sum(axis=1)
            gain, unlike = self._two_zones_gain(
                self.zones[two, 0], self.scatter[:, two], joint_sums
            )

            # The pair with the least gain that is not two zones.
            for pair in gain.argsort(kind="stable"):
                i, j = int(a[pair]), int(b[pair])
                inside = (self.labels == i) | (self.labels == j)
                least = (VALLEY_MIN if gain[pair] > 0 else VALLEY_ALONE) / self.hold
                if (
                    not unlike[pair]
                    and self._valley_between(self.zones[i], self.zones[j], inside) < least
                ):
                    break
            else:
                return

            # Drop the smaller one or merge the two.
            small = i if self.zones[i, 0] < self.zones[j, 0] else j
            if (
                gain[pair] > 0
                and self._drop_gain(np.array([small]), 1 / self.hold)[0] > -gain[pair]
            ):
                self._remove(small)
            else:
                self._join(i, j)

    def _drop(self) -> None:
        """Turn groups that are better explained as clutter into clutter, the worst group first."""
        while len(self.zones) > 1:
            gain = self._drop_gain(np.arange(len(self.zones)), 1 / self.hold)
            gain[self.zones[:, 0] < ZONE_EVENTS_MIN] = np.inf
            k = int(gain.argmax())
            if gain[k] <= 0:
                return
            self._remove(k)

    def _drop_gain(self, zones: Labels, hold: float) -> Floats:
        """Return the gain (z,) of log posterior if a group became clutter, for each of some groups.

        zones (z,): the groups.
        hold: factor on `EXCESS_MIN`.

        The gain is negative if the group stands out from the clutter around it by more than
        ``hold`` times `EXCESS_MIN`.
        """
        # The marginal likelihoods.
        n = self.zones[zones, 0]
        count = len(self.zones)
        total = np.array(self.total)
        gain = (
            log_zones(count - 1, total)
            - log_zones(count, total)
            - log_zone(n, self.scatter[:, zones])
        )
        gain += gammaln(self.clutter + n + 1) - gammaln(self.clutter + 1) + self.as_clutter[zones]

        # The log likelihood ratio that the Poisson mean of the events there is beyond the expected.
        n, expected = self._inside(zones)
        surplus = (n * np.log(n / expected) - n + expected) * np.sign(n - expected)
        return np.where(gain > 0, np.minimum(gain, EXCESS_MIN * hold - surplus), gain)

    def _drop_ways(self) -> bool:
        """Turn groups that are pieces of ways into clutter; return True if there is any.

        A rare door and its ways may have become one group. So a group shrinks to its densest place
        if that is a zone. Of several groups, the one with the most contrast stays.
        """
        contrast = np.array([self._contrast(k) for k in range(len(self.zones))])
        labels = self.labels.copy()
        for k in np.flatnonzero(
            (contrast < WAY_CONTRAST / self.hold) & (contrast < contrast.max(initial=0.0))
        ):
            inside = np.flatnonzero(labels == k)
            places = self.cells.average[1:3, inside] * [[GRID_COLUMNS], [GRID_ROWS]]
            dense = places[:, [self.cells.sums[0, inside].argmax()]]
            core = np.hypot(*(places - dense)) < _CORE
            sums = self.cells.sums[:, inside[core]].sum(axis=1)
            is_even = way_contrast(self.cells, sums, self.rates) < WAY_CONTRAST
            labels[inside[is_even | ~core]] = -1
        is_changed = bool((labels != self.labels).any())
        if is_changed:
            self._set(labels)
        return is_changed

    def _contrast(self, k: int) -> float:
        """Return the `way_contrast` of zone ``k``; results are cached."""
        key = self.zones[k].tobytes()
        if key not in self.contrasts:
            self.contrasts[key] = way_contrast(self.cells, self.zones[k], self.rates)
        return self.contrasts[key]

    def _inside(self, zones: Labels) -> tuple[Floats, Floats]:
        """Return the number of events around each of some zones, and the expected clutter, (z,).

        zones (z,): the zones.

        Events count within two standard deviations of the zone's centre, unless in another zone.
        """
        # The cells around each zone (z, cells of the grid).
        xx, xy, yy = (self.cov[:, zones] + CELL_SPREAD)[:, :, None, None]
        x, y = self.mean[:, zones, None, None]
        dx = CELL_X - x
        dy = CELL_Y - y
        square = yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy
        inside = (square < 4 * (xx * yy - xy * xy)).reshape(len(zones), -1)

        # Leave out cells of other zones.
        labels = np.full(len(self.density), -1)
        labels[self.cells.index] = self.labels
        free = labels < 0
        inside &= free | (labels == zones[:, None])

        # The events there, and the expected ones from the density of clutter in all free cells.
        expected, n = (inside.astype(np.float64) @ self.grids).T
        scale = (self.clutter + 1) / max(float(self.density @ free), 1.0)
        return np.maximum(n, 1e-9), np.maximum(expected, self.density.min()) * scale

    def _two_zones_gain(
        self, n: Floats, scatter: Floats, joint_sums: Floats
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the gain of log posterior of two zones over one, and where no valley is needed.

        n (2, ..., m): number of events of the two groups of each pair.
        scatter (3, 2, ..., m): `moments` of the two groups of each pair.
        joint_sums (6, m): sums of the two groups together.

        No valley is needed if the gain per event of the smaller group exceeds
        `UNLIKE_GAIN_PER_EVENT`. Both results are (..., m).
        """
        # Terms of the prior that are the same for one and two zones are left out.
        weight = 1 / (1 + joint_sums[0] / PAIR_EVENTS)
        count = len(self.zones)
        total = self.total * weight
        whole = log_zone(joint_sums[0] * weight, moments(joint_sums * weight)[1])
        whole += log_zones(count, total) - log_zones(count + 1, total)
        first, second = log_zone(n * weight, scatter * weight)
        gain = first + second - whole
        return gain, gain > UNLIKE_GAIN_PER_EVENT * np.minimum(*n) * weight

    def _valley_between(self, a: Floats, b: Floats, inside: NDArray[np.bool_]) -> float:
        """Return the log likelihood ratio of a valley between two groups; results are cached.

        a, b (6,): sums of the groups.
        inside (m,): mask of their cells.
        """
        key = min(a.tobytes() + b.tobytes(), b.tobytes() + a.tobytes())
        if key not in self.valleys:
            weight = 1 / (1 + (a[0] + b[0]) / PAIR_EVENTS)
            self.valleys[key] = valley_between(self.cells, a, b, inside, self.labels < 0, weight)
        return self.valleys[key]

    def _assign(self) -> bool:
        """Assign each cell to the Gaussian or the clutter that explains its events best on average.

        Return True if the partition changes.
        """
        if not len(self.zones):
            return False

        # The mean log density of a cell's events is linear in their mean sums: its coefficients.
        (x, y) = self.mean
        (xx, xy, yy) = self.cov
        determinant = xx * yy - xy * xy
        to_x = (yy * x - xy * y) / determinant
        to_y = (xx * y - xy * x) / determinant
        share = (
            np.log(self.zones[:, 0] + 1)
            - np.log(2 * np.pi)
            - 0.5 * (np.log(determinant) + to_x * x + to_y * y)
        )
        score = np.array(
            (share, to_x, to_y, -0.5 * yy / determinant, xy / determinant, -0.5 * xx / determinant)
        ).T

        # Compare the zones with each other and with the clutter.
        score = score @ self.cells.average
        in_zone = score.max(axis=0) > np.log(self.clutter + 1) + self.log_density
        labels = np.where(in_zone, score.argmax(axis=0), -1)
        is_changed = bool((labels != self.labels).any())
        if is_changed:
            self._set(labels)
        return is_changed

    def _split(self) -> bool:
        """Split every group that is two zones; return True if there is any."""
        labels = self.labels.copy()
        keys = [zone.tobytes() for zone in self.zones]
        uncertain = [k for k in range(len(keys)) if keys[k] not in self.whole_zones]
        for k in uncertain:
            part = self._cut(k)
            if part is None:
                self.whole_zones.add(keys[k])
            else:
                labels[part] = labels.max() + 1
        is_changed = bool((labels != self.labels).any())
        if is_changed:
            self._set(labels)
        return is_changed

    def _cut(self, zone: int) -> NDArray[np.intp] | None:
        """Return the cells beyond the best straight cut that makes two zones of one; None if none.

        zone: number of the zone.
        """
        cells = np.flatnonzero(self.labels == zone)
        if len(cells) < 2:
            return None

        # The sums on both sides of every cut: sides (6, 2, directions, cuts). Across each
        # direction, there is a cut after each cell but the last one.
        order = cells[(_DIRECTIONS @ self.cells.average[1:3, cells]).argsort(axis=1, kind="stable")]
        joint_sums = self.zones[zone][:, None]
        first = np.cumsum(self.cells.sums[:, order], axis=2)[:, :, :-1]
        sides = np.stack((first, joint_sums[:, None] - first), axis=1)

        # The best cut, if it makes two zones.
        gain, unlike = self._two_zones_gain(sides[0], moments(sides)[1], joint_sums)
        angle, at = np.unravel_index(int(gain.argmax()), gain.shape)
        least = (VALLEY_MIN if gain[angle, at] > 0 else VALLEY_ALONE) * self.hold
        left, right = sides[:, :, angle, at].T
        if unlike[angle, at] or self._valley_between(left, right, self.labels == zone) >= least:
            return order[angle, at + 1 :]
        return None
