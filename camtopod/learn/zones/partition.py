"""Which cells of a camera's grid make a zone: DaSpec, made robust (thesis 4.2; `daspec`).

1. The *density floor*: the rate of clutter around each cell is estimated from the sparse cells, and cells whose
   surroundings are explained by it are left out (`clutter`).
2. *DaSpec* over the remaining cells, and again over those that no kept eigenvector reaches (a zone with under
   5 % of the points is such), at half the bandwidth of the rule: too many groups rather than too few.
3. *Moves* until none helps: groups that are not two zones are merged, groups that are not denser than clutter
   are dropped, cells go to the Gaussian that explains them best, groups that are two zones are split, and
   DaSpec looks again among the clutter.

Two groups are two zones when two Gaussians explain them better than one (`evidence`) and there is a
valley between them (`valley`). The first alone would cut every zone that is not Gaussian, the
second is weak with few events.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from camtopod.arrays import Floats
from camtopod.learn.zones.clutter import (
    CONTRAST_MIN,
    FLOOR_CHANCE,
    FOUND_CHANCE,
    dense_cells,
    groups_of,
)
from camtopod.learn.zones.marginal_likelihood import (
    covariance,
    gaussians,
    log_zone,
    log_zones,
    moments,
)
from camtopod.learn.zones.separation import discriminant, far, sd_along, valley
from camtopod.topology import GRID_COLUMNS, GRID_ROWS

Labels = NDArray[np.intp]

EVENTS_MIN = 5
"""Below this a camera is one zone."""
ZONE_EVENTS_MIN = 3
"""Two events make no zone beside others, however close together: where there is hardly any clutter
it is unlikely that two coincide, but they show no place, which has an extent either way."""
PAIR_EVENTS = 1000.0
"""No zone is exactly Gaussian: in splitting and merging, n events weigh as n / (1 + n /
PAIR_EVENTS) (Miller, Dunson: Robust Bayesian inference via coarsening, JASA 2019)."""
VALLEY_MIN = 3.5
"""Log likelihood ratio of a valley that two Gaussians' evidence needs beside it."""
VALLEY_ALONE = 8.0
"""One that needs no other evidence (several doors in a row look like one Gaussian to any single
cut).
"""
UNLIKE = 2.0
"""So much log likelihood for each event of the smaller group shows two zones without a valley."""
EXCESS_MIN = 11.0
"""Log likelihood ratio at which a surplus stands out from clutter wherever it may be: a fire door's
zone, say, though half of the events in its cells are clutter and so its Gaussian fits badly."""
HOLD = 1.5
"""While zones are held, what makes a new one must be so many times as clear as at first, and one
goes when it is so many times less clear; else the numbers of zones would flicker."""
HOLD_GAIN = 3.0
"""The same where evidence is compared with none: so much log likelihood for the change."""
_ROUNDS_MAX = 6
_GAIN_HOPELESS = -10.0
_X = (np.arange(GRID_COLUMNS) + 0.5) / GRID_COLUMNS
_Y = ((np.arange(GRID_ROWS) + 0.5) / GRID_ROWS)[:, None]
_CELL_SPREAD = np.array([[1 / GRID_COLUMNS**2], [0.0], [1 / GRID_ROWS**2]]) / 12
_ANGLES = np.arange(6) * np.pi / 6
_DIRECTIONS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
_CUTS_TRIED = 2
_FIRST = np.arange(len(_ANGLES))[:, None]


class Cells(NamedTuple):
    """The m occupied cells: flat index, sums (6, m) in image units (see `evidence`), the same for
    each event, and the spread of the events within the cell (3, m: xx, xy, yy)."""

    index: NDArray[np.intp]  # type: ignore[assignment]  # hides a method of tuple nobody needs
    sums: Floats
    average: Floats
    spread: Floats

    @classmethod
    def of(cls, sums: Floats, index: NDArray[np.intp]) -> Cells:
        """Cells from their sums (6, m) and flat indices (m,); no cell may be empty."""
        average = sums / sums[0]
        _, x, y, xx, xy, yy = average
        spread = np.array((np.maximum(xx - x * x, 0), xy - x * y, np.maximum(yy - y * y, 0)))
        return cls(index, sums, average, spread)


def partition(
    cells: Cells, count: NDArray[np.int64], rates: Floats, held: Labels | None = None
) -> Labels:
    """The zone of each occupied cell, counted from 0, or -1 for clutter; ``count`` (rows, columns)
    are all events, ``rates`` those of clutter (`clutter_rates`).

    ``held`` is the partition so far. It is changed only where the evidence is clear (`HOLD`).
    """
    one = np.zeros(len(cells.index), dtype=np.intp)
    if held is not None and held.max() >= 0 and count.sum() >= EVENTS_MIN:
        labels = _Moves(cells, held, rates, held=True).settle()
        return labels if labels.max() >= 0 else one
    if count.sum() < EVENTS_MIN:
        return one
    dense = dense_cells(count, rates, FLOOR_CHANCE)
    groups = groups_of(dense if dense.any() else count.astype(np.float64))
    labels = _Moves(cells, groups[cells.index], rates).settle()
    return labels if labels.max() >= 0 else one


class _Moves:
    """A partition of the cells being improved. ``zones`` (K, 6) are the sums of the groups,
    ``clutter`` the number of events outside."""

    def __init__(self, cells: Cells, labels: Labels, rates: Floats, held: bool = False) -> None:
        self.cells = cells
        self.hold, self.hold_gain = (HOLD, HOLD_GAIN) if held else (1.0, 0.0)
        self.rates = rates
        self.density = (rates / rates.mean()).ravel()  # of clutter, relative to a uniform one
        self.log_density = np.log(self.density[cells.index])
        self.grids = np.zeros((len(self.density), 2))  # clutter's density, and the events
        self.grids[:, 0] = self.density
        self.grids[cells.index, 1] = cells.sums[0]
        self.weighed = cells.sums[0] * self.log_density
        self.total = float(cells.sums[0].sum())
        self.valleys: dict[bytes, float] = {}
        self.uncut: set[bytes] = set()
        self.tried: set[bytes] = set()
        self._set(labels)

    def _set(self, labels: Labels) -> None:
        present = np.bincount(labels + 1, minlength=1) > 0
        present[0] = False
        numbers = np.cumsum(present) - 1
        numbers[0] = -1
        self.labels = numbers[labels + 1]
        # Sums of positions in fixed point have no rounding, in whatever order they are added.
        self.zones = (self.labels == np.arange(numbers[-1] + 1)[:, None]).astype(
            np.float64
        ) @ self.cells.sums.T
        self.mean, self.scatter = moments(self.zones.T)
        self.cov = covariance(self.zones[:, 0], self.scatter)
        self.as_clutter = np.bincount(self.labels + 1, self.weighed, len(self.zones) + 1)[1:]
        self.clutter = self.total - float(self.zones[:, 0].sum())

    def settle(self) -> Labels:
        for _ in range(_ROUNDS_MAX):
            self._merge()
            self._drop()
            if self._assign():
                self._assign()
            if not self._split() and not self._found():
                return self.labels
        self._merge()
        self._drop()
        return self.labels

    def _found(self) -> bool:
        """Make zones of what DaSpec finds among the clutter, where it is more than clutter; whether
        any was.

        Such are zones that DaSpec had put together with a bigger one, and whose cells that one's
        Gaussian then left.
        """
        outside = self.labels < 0
        if len(self.zones) == 0 or not outside.any():
            return False
        count = np.zeros(GRID_ROWS * GRID_COLUMNS)
        count[self.cells.index[outside]] = self.cells.sums[0, outside]
        labels, known = self.labels, len(self.zones)
        dense = dense_cells(count.reshape(GRID_ROWS, GRID_COLUMNS), self.rates, FOUND_CHANCE)
        if not dense.any():
            return False
        groups = groups_of(dense)[self.cells.index]
        self._set(np.where(groups >= 0, groups + known, labels))
        keys = [zone.tobytes() for zone in self.zones[known:]]
        for k in range(len(self.zones) - 1, known - 1, -1):
            enough = self.zones[k, 0] >= ZONE_EVENTS_MIN
            stays = enough and self._drop_gain(np.array([k]), self.hold)[0] < -self.hold_gain
            if keys[k - known] in self.tried or not stays or self._is_tail(k):
                self._remove(k)
        self.tried.update(keys)
        return len(self.zones) > known

    def _is_tail(self, k: int) -> bool:
        """Whether the density falls all the way from a bigger zone to this one, however far: a
        heavy tail's events."""
        others = np.flatnonzero(self.zones[:, 0] > self.zones[k, 0])
        return any(
            self._valley_between(
                self.zones[j], self.zones[k], (self.labels == j) | (self.labels == k)
            )
            < VALLEY_MIN
            for j in others
        )

    def _join(self, a: int, b: int) -> None:
        self._set(np.where(self.labels == b, a, self.labels))

    def _remove(self, k: int) -> None:
        self._set(np.where(self.labels == k, -1, self.labels))

    def _merge(self) -> None:
        """Merge pairs that are not two zones, the likeliest first; a small one that is unlike its
        neighbour goes to the clutter instead where that costs less."""
        while len(self.zones) > 1:
            zones = np.arange(len(self.zones))
            a, b = np.nonzero(zones[:, None] < zones)
            two = np.stack((a, b))
            sides = self.zones[two, 0], self.mean[:, two], self.scatter[:, two]
            gain, clear = self._apart(
                *sides, self.zones.T[:, two].sum(axis=1), slice(None), -self.hold_gain
            )
            wanted = np.where(gain > -self.hold_gain, VALLEY_MIN, VALLEY_ALONE) / self.hold
            for pair in gain.argsort(kind="stable"):
                i, j = int(a[pair]), int(b[pair])
                inside = (self.labels == i) | (self.labels == j)
                if (
                    not clear[pair]
                    and self._valley_between(self.zones[i], self.zones[j], inside) < wanted[pair]
                ):
                    break
            else:
                return
            small = i if self.zones[i, 0] < self.zones[j, 0] else j
            if (
                gain[pair] > 0
                and self._drop_gain(np.array([small]), 1 / self.hold)[0] > -gain[pair]
            ):
                self._remove(small)
            else:
                self._join(i, j)

    def _drop(self) -> None:
        while len(self.zones) > 1:
            gain = self._drop_gain(np.arange(len(self.zones)), 1 / self.hold)
            gain[self.zones[:, 0] < ZONE_EVENTS_MIN] = np.inf
            k = int(gain.argmax())
            if gain[k] <= self.hold_gain:
                return
            self._remove(k)

    def _drop_gain(self, which: Labels, hold: float) -> Floats:
        """What the log posterior gains when a zone is clutter instead; but nothing where it stands
        out (`EXCESS_MIN`), and something where it is hardly denser than the clutter around it."""
        n, count = self.zones[which, 0], len(self.zones)
        total = np.array(self.total)
        gain = (
            log_zones(count - 1, total)
            - log_zones(count, total)
            - log_zone(n, self.scatter[:, which])
        )
        gain += gammaln(self.clutter + n + 1) - gammaln(self.clutter + 1) + self.as_clutter[which]
        inside, expected = self._inside(which)
        surplus, contrast = _log_surplus(inside, np.array((expected, CONTRAST_MIN * expected)))
        gain = np.where(gain > 0, np.minimum(gain, EXCESS_MIN * hold - surplus), gain)
        return np.asarray(np.maximum(gain, -contrast))

    def _inside(self, which: Labels) -> tuple[Floats, Floats]:
        """Events within two standard deviations of each zone that are in no other one; those
        expected of clutter.
        """
        xx, xy, yy = (self.cov[:, which] + _CELL_SPREAD)[:, :, None, None]
        x, y = self.mean[:, which, None, None]
        dx, dy = _X - x, _Y - y
        square = yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy
        inside = (square < 4 * (xx * yy - xy * xy)).reshape(len(which), -1)
        labels = np.full(len(self.density), -1)
        labels[self.cells.index] = self.labels
        free = labels < 0
        inside &= free | (labels == which[:, None])
        expected, n = (inside.astype(np.float64) @ self.grids).T
        scale = (self.clutter + 1) / max(float(self.density @ free), 1.0)
        return np.maximum(n, 1e-9), np.maximum(expected, self.density.min()) * scale

    def _apart(
        self,
        n: Floats,
        mean: Floats,
        scatter: Floats,
        both: Floats,
        of: Labels | slice,
        least: float,
    ) -> tuple[Floats, NDArray[np.bool_]]:
        """What the log posterior gains by two zones instead of one, and whether that alone shows
        two: where they are far apart, or where an event of the smaller one is very unlike the
        other. Otherwise the gain is a coarsened one, and a valley is wanted.

        The numbers of events of the two (2, ..., m) and their `moments`; ``both`` (6, wholes) are
        the sums of both together, of which ``of`` says which is whose.
        """
        well_apart = far(n, mean, scatter)
        weigh = 1 / (1 + both[0] / PAIR_EVENTS)
        weights = np.array((weigh, np.ones_like(weigh)))
        wholes = self._one_zone(both[:, None] * weights, self.total * weights)[:, of]
        weight, whole = weigh[of], wholes[0]
        if well_apart.any():
            weight, whole = (
                np.where(well_apart, 1.0, weight),
                np.where(well_apart, wholes[1], whole),
            )
        first, second = log_zone(n * weight, scatter * weight)
        gain = first + second - whole
        unlike = gain > UNLIKE * np.minimum(*n) * weight
        return gain, (gain > least) & (well_apart | unlike)

    def _one_zone(self, groups: Floats, total: Floats) -> Floats:
        """Log posterior of groups (6, ...) as one zone, but for what stays when they become two."""
        count = len(self.zones)
        return (
            log_zone(groups[0], moments(groups)[1])
            + log_zones(count, total)
            - log_zones(count + 1, total)
        )

    def _valley_between(self, a: Floats, b: Floats, inside: NDArray[np.bool_]) -> float:
        """Log likelihood ratio of a valley between groups with sums ``a`` and ``b`` (6,), cells
        ``inside``.
        """
        key = min(a.tobytes() + b.tobytes(), b.tobytes() + a.tobytes())
        if key not in self.valleys:
            self.valleys[key] = self._valley(a, b, inside)
        return self.valleys[key]

    def _valley(self, a: Floats, b: Floats, inside: NDArray[np.bool_]) -> float:
        mean, cov = gaussians(np.stack((a, b), axis=1))
        (x, to_x), (y, to_y) = mean.tolist()
        to_x, to_y = to_x - x, to_y - y
        line_x, line_y = line = discriminant(cov.sum(axis=1).tolist(), (to_x, to_y))
        covs = cov.T.tolist()
        sd_a, sd_b = (sd_along(own, line) for own in covs)
        apart = line_x * to_x + line_y * to_y
        if apart == 0.0:
            return 0.0  # around one point there is nothing in between
        # Clutter in the tube between the two belongs to the valley.
        dx, dy = self.cells.average[1] - x, self.cells.average[2] - y
        along = line_x * dx + line_y * dy
        aside = line_x * dy - line_y * dx - along * ((line_x * to_y - line_y * to_x) / apart)
        width = max(sd_along(own, (-line_y, line_x)) for own in covs)
        tube = (self.labels < 0) & (along > 0) & (along < apart) & (np.abs(aside) < 2 * width)
        chosen = np.flatnonzero(inside | tube)
        n = self.cells.sums[0, chosen] / (1 + (a[0] + b[0]) / PAIR_EVENTS)
        sd = sd_along(self.cells.spread[:, chosen], line)
        return valley(n, along[chosen], sd, -2 * sd_a, apart + 2 * sd_b)

    def _assign(self) -> bool:
        """Each cell to the Gaussian, or the clutter, that explains its events best on average;
        whether any changed.
        """
        if not len(self.zones):
            return False
        (x, y), (xx, xy, yy) = self.mean, self.cov
        determinant = xx * yy - xy * xy
        to_x, to_y = (yy * x - xy * y) / determinant, (xx * y - xy * x) / determinant
        share = (
            np.log(self.zones[:, 0] + 1)
            - np.log(2 * np.pi)
            - 0.5 * (np.log(determinant) + to_x * x + to_y * y)
        )
        # The mean log density of a cell's events is linear in their mean sums.
        score = np.array(
            (share, to_x, to_y, -0.5 * yy / determinant, xy / determinant, -0.5 * xx / determinant)
        ).T
        score = score @ self.cells.average
        explained = score.max(axis=0) > np.log(self.clutter + 1) + self.log_density
        labels = np.where(explained, score.argmax(axis=0), -1)
        changed = bool((labels != self.labels).any())
        if changed:
            self._set(labels)
        return changed

    def _split(self) -> bool:
        """Split every group that is two zones; whether any was."""
        labels = self.labels.copy()
        keys = [zone.tobytes() for zone in self.zones]
        looked = [k for k in range(len(keys)) if keys[k] not in self.uncut]
        parts = self._cuts(looked)
        for k in looked:
            if k in parts:
                labels[parts[k]] = labels.max() + 1
            else:
                self.uncut.add(keys[k])
        changed = bool((labels != self.labels).any())
        if changed:
            self._set(labels)
        return changed

    def _cuts(self, which: list[int]) -> dict[int, NDArray[np.intp]]:
        """Of each of these zones that a straight cut makes two zones the cells on one side of the
        best such cut.
        """
        filled = np.bincount(self.labels + 1)[1:]
        which = [k for k in which if filled[k] > 1]
        if not which:
            return {}
        rank = np.full(len(self.zones) + 1, -1, dtype=np.int16)  # the last one for clutter
        rank[which] = np.arange(len(which))
        own = rank[self.labels]
        cells = np.flatnonzero(own >= 0)
        own = own[cells]
        by_place = (_DIRECTIONS @ self.cells.average[1:3, cells]).argsort(axis=1, kind="stable")
        by_zone = own[by_place].argsort(axis=1, kind="stable") + _FIRST * len(own)
        order = cells[by_place.ravel()[by_zone]]
        size = filled[which]
        end = np.cumsum(size)
        of = np.repeat(np.arange(len(which)), size - 1)
        both = self.zones[which].T
        sides = np.empty((6, 2, len(order), len(of)))
        # Behind each cell but a zone's last one there is a cut.
        upto = np.cumsum(self.cells.sums[:, order], axis=2)[:, :, np.arange(len(of)) + of]
        np.subtract(upto, (np.cumsum(both, axis=1) - both)[:, None, of], out=sides[:, 0])
        np.subtract(both[:, None, of], sides[:, 0], out=sides[:, 1])
        gain, clear = self._apart(sides[0], *moments(sides), both, of, self.hold_gain)
        best = np.maximum.reduceat(gain, end - size - np.arange(len(which)), axis=1).T
        result = {}
        for nth in np.flatnonzero(best.max(axis=1) > _GAIN_HOPELESS).tolist():
            members = slice(end[nth] - size[nth], end[nth])
            cuts = slice(end[nth] - size[nth] - nth, end[nth] - nth - 1)
            part = self._best_cut(
                best[nth], order[:, members], sides[..., cuts], gain[:, cuts], clear[:, cuts]
            )
            if part is not None:
                result[which[nth]] = part
        return result

    def _best_cut(
        self,
        best: Floats,
        order: NDArray[np.intp],
        sides: Floats,
        gain: Floats,
        clear: NDArray[np.bool_],
    ) -> NDArray[np.intp] | None:
        """The cells beyond the best cut that shows two zones. ``best`` gains (directions,),
        ``order`` of the cells (directions, cells); ``sides`` and what follows are of the cuts (...,
        directions, cuts)."""
        inside = np.zeros(len(self.labels), dtype=np.bool_)
        inside[order[0]] = True
        for angle in best.argsort(kind="stable")[::-1][:_CUTS_TRIED].tolist():
            if best[angle] > _GAIN_HOPELESS:
                at = int(gain[angle].argmax())
                wanted = (VALLEY_MIN if best[angle] > self.hold_gain else VALLEY_ALONE) * self.hold
                left, right = sides[:, :, angle, at].T
                if clear[angle, at] or self._valley_between(left, right, inside) >= wanted:
                    return order[angle, at + 1 :]
        return None


def _log_surplus(n: Floats, expected: Floats) -> Floats:
    """Log likelihood ratio of ``n`` events where ``expected`` were (Poisson), negative where there
    are fewer.
    """
    return np.asarray((n * np.log(n / expected) - n + expected) * np.sign(n - expected))
