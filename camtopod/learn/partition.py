"""Which cells of a camera's grid make a zone: DaSpec, made robust (thesis 4.2; `daspec`).

1. The *density floor*: the rate of clutter around each cell is estimated from the sparse cells, and cells whose
   surroundings are explained by it are left out (`clutter`).
2. *DaSpec* over the remaining cells, and again over those that no kept eigenvector reaches (a zone with under
   5 % of the points is such), at half the bandwidth of the rule: too many groups rather than too few.
3. *Moves* until none helps: groups that are not two zones are merged, groups that are not denser than clutter
   are dropped, cells go to the Gaussian that explains them best, groups that are two zones are split, and
   DaSpec looks again among the clutter.

Two groups are two zones when two Gaussians explain them better than one (`evidence`) and there is a valley
between them (`valley`). The first alone would cut every zone that is not Gaussian, the second is weak with
few events.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from camtopod.learn.clutter import CONTRAST_MIN, FLOOR_CHANCE, FOUND_CHANCE, dense_cells, groups_of
from camtopod.learn.evidence import gaussians, log_evidence, log_share, log_zones
from camtopod.learn.settings import GRID_COLUMNS, GRID_ROWS
from camtopod.learn.valley import valley

Floats = NDArray[np.float64]
Labels = NDArray[np.intp]

EVENTS_MIN = 5
"""Below this a camera is one zone."""
ZONE_EVENTS_MIN = 3
"""Two events make no zone beside others, however close together: where there is hardly any clutter it is unlikely that
two coincide, but they show no place, which has an extent either way."""
PAIR_EVENTS = 1000.0
"""No zone is exactly Gaussian: in splitting and merging, n events weigh as n / (1 + n / PAIR_EVENTS) (Miller,
Dunson: Robust Bayesian inference via coarsening, JASA 2019)."""
VALLEY_MIN = 3.5
"""Log likelihood ratio of a valley that two Gaussians' evidence needs beside it."""
VALLEY_ALONE = 8.0
"""One that needs no other evidence (several doors in a row look like one Gaussian to any single cut)."""
FAR = 3.0
"""Two centres further apart than this many of their summed standard deviations need no valley."""
UNLIKE = 2.0
"""So much log likelihood for each event of the smaller group shows two zones without a valley."""
EXCESS_MIN = 11.0
"""Log likelihood ratio at which a surplus stands out from clutter wherever it may be: a fire door's zone,
say, though half of the events in its cells are clutter and so its Gaussian fits badly."""
HOLD = 1.5
"""While zones are held, what makes a new one must be so many times as clear as at first, and one goes when it is so
many times less clear; else the numbers of zones would flicker."""
HOLD_GAIN = 3.0
"""The same where evidence is compared with none: so much log likelihood for the change."""
_ROUNDS_MAX = 6
_GAIN_HOPELESS = -10.0
_CENTRES = np.stack(
    [
        np.tile((np.arange(GRID_COLUMNS) + 0.5) / GRID_COLUMNS, GRID_ROWS),
        np.repeat((np.arange(GRID_ROWS) + 0.5) / GRID_ROWS, GRID_COLUMNS),
    ]
)
_CELL_SPREAD = np.array([1 / GRID_COLUMNS**2, 0.0, 1 / GRID_ROWS**2]) / 12
_ANGLES = np.arange(6) * np.pi / 6
_DIRECTIONS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])
_CUTS_TRIED = 2


class Cells(NamedTuple):
    """The m occupied cells: flat index, sums (m, 6) in image units (see `evidence`), mean (m, 2) and the
    spread of the events within the cell (m, 3: xx, xy, yy)."""

    index: NDArray[np.intp]  # type: ignore[assignment]  # hides a method of tuple nobody needs
    sums: Floats
    mean: Floats
    spread: Floats

    @classmethod
    def of(cls, sums: Floats, index: NDArray[np.intp]) -> Cells:
        """Cells from their sums (m, 6) and flat indices (m,); no cell may be empty."""
        n = sums[:, 0]
        x, y = sums[:, 1] / n, sums[:, 2] / n
        xx, yy = np.maximum(sums[:, 3] / n - x * x, 0), np.maximum(sums[:, 5] / n - y * y, 0)
        return cls(index, sums, np.stack([x, y], 1), np.stack([xx, sums[:, 4] / n - x * y, yy], 1))


def partition(cells: Cells, count: NDArray[np.int64], rates: Floats, held: Labels | None = None) -> Labels:
    """The zone of each occupied cell, counted from 0, or -1 for clutter; ``count`` (rows, columns) are all
    events, ``rates`` those of clutter (`clutter_rates`).

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
    """A partition of the cells being improved. ``zones`` (K, 6) are the sums of the groups, ``clutter`` the
    number of events outside."""

    def __init__(self, cells: Cells, labels: Labels, rates: Floats, held: bool = False) -> None:
        self.cells = cells
        self.hold, self.hold_gain = (HOLD, HOLD_GAIN) if held else (1.0, 0.0)
        self.rates = rates
        self.density = (rates / rates.mean()).ravel()  # of clutter, relative to a uniform one
        self.log_density = np.log(self.density[cells.index])
        self.total = float(cells.sums[:, 0].sum())
        self.valleys: dict[bytes, float] = {}
        self.uncut: set[bytes] = set()
        self.tried: set[bytes] = set()
        self._set(labels)

    def _set(self, labels: Labels) -> None:
        inside = labels >= 0
        present = np.bincount(labels[inside]) > 0
        compact = (np.cumsum(present) - 1)[labels[inside]]
        self.labels = np.full(len(labels), -1, dtype=np.intp)
        self.labels[inside] = compact
        self.zones = np.zeros((int(self.labels.max(initial=-1)) + 1, 6))
        np.add.at(self.zones, compact, self.cells.sums[inside])
        self.as_clutter = np.bincount(compact, (self.cells.sums[:, 0] * self.log_density)[inside], len(self.zones))
        self.clutter = self.total - float(self.zones[:, 0].sum())

    def settle(self) -> Labels:
        for _ in range(_ROUNDS_MAX):
            self._merge()
            self._drop()
            self._assign()
            self._assign()
            if not self._split() and not self._found():
                return self.labels
        self._merge()
        self._drop()
        return self.labels

    def _found(self) -> bool:
        """Make zones of what DaSpec finds among the clutter, where it is more than clutter; whether any was.

        Such are zones that DaSpec had put together with a bigger one, and whose cells that one's Gaussian
        then left.
        """
        outside = self.labels < 0
        if len(self.zones) == 0 or not outside.any():
            return False
        count = np.zeros(GRID_ROWS * GRID_COLUMNS)
        count[self.cells.index[outside]] = self.cells.sums[outside, 0]
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
        """Whether the density falls all the way from a bigger zone to this one, however far: a heavy tail's
        events."""
        others = np.flatnonzero(self.zones[:, 0] > self.zones[k, 0])
        return any(
            self._valley_between(self.zones[j], self.zones[k], (self.labels == j) | (self.labels == k)) < VALLEY_MIN
            for j in others
        )

    def _join(self, a: int, b: int) -> None:
        self._set(np.where(self.labels == b, a, self.labels))

    def _remove(self, k: int) -> None:
        self._set(np.where(self.labels == k, -1, self.labels))

    def _merge(self) -> None:
        """Merge pairs that are not two zones, the likeliest first; a small one that is unlike its neighbour
        goes to the clutter instead where that costs less."""
        while len(self.zones) > 1:
            a, b = np.triu_indices(len(self.zones), 1)
            gain, clear = self._apart(self.zones[a], self.zones[b], -self.hold_gain)
            wanted = np.where(gain > -self.hold_gain, VALLEY_MIN, VALLEY_ALONE) / self.hold
            for pair in gain.argsort(kind="stable"):
                i, j = int(a[pair]), int(b[pair])
                inside = (self.labels == i) | (self.labels == j)
                if not clear[pair] and self._valley_between(self.zones[i], self.zones[j], inside) < wanted[pair]:
                    break
            else:
                return
            small = i if self.zones[i, 0] < self.zones[j, 0] else j
            if gain[pair] > 0 and self._drop_gain(np.array([small]), 1 / self.hold)[0] > -gain[pair]:
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
        """What the log posterior gains when a zone is clutter instead; but nothing where it stands out (`EXCESS_MIN`),
        and something where it is hardly denser than the clutter around it."""
        n, count = self.zones[which, 0], len(self.zones)
        total = np.array(self.total)
        prior = log_zones(count - 1, total) - log_zones(count, total) - log_share(n)
        gain = prior + gammaln(self.clutter + n + 1) - gammaln(self.clutter + 1)
        gain += self.as_clutter[which] - log_evidence(self.zones[which])
        inside, expected = self._inside(which)
        doubt = EXCESS_MIN * hold - _log_surplus(inside, expected)
        gain = np.where(gain > 0, np.minimum(gain, doubt), gain)
        return np.asarray(np.maximum(gain, -_log_surplus(inside, CONTRAST_MIN * expected)))

    def _inside(self, which: Labels) -> tuple[Floats, Floats]:
        """Events within two standard deviations of each zone that are in no other one; those expected of clutter."""
        mean, cov = gaussians(self.zones[which])
        xx, xy, yy = (cov + _CELL_SPREAD).T[:, :, None]
        dx, dy = _CENTRES[0] - mean[:, :1], _CENTRES[1] - mean[:, 1:]
        inside = yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy < 4 * (xx * yy - xy * xy)
        inside[:, self.cells.index] &= (self.labels < 0) | (self.labels == which[:, None])
        outside = self.density.sum() - self.density[self.cells.index[self.labels >= 0]].sum()
        expected = np.maximum(inside @ self.density, self.density.min()) * (self.clutter + 1) / max(outside, 1.0)
        n = np.maximum((inside[:, self.cells.index] * self.cells.sums[:, 0]).sum(axis=1), 1e-9)
        return n, expected

    def _apart(self, a: Floats, b: Floats, least: float) -> tuple[Floats, NDArray[np.bool_]]:
        """What the log posterior gains by two zones ``a`` and ``b`` (..., 6) instead of one, and whether that
        alone shows two: where they are far apart, or where an event of the smaller one is very unlike the
        other. Otherwise the gain is a coarsened one, and a valley is wanted.
        """
        n = a[..., 0] + b[..., 0]
        weigh = 1 / (1 + n / PAIR_EVENTS)
        (mean_a, cov_a), (mean_b, cov_b) = gaussians(a), gaussians(b)
        line = _discriminant(cov_a + cov_b, mean_b - mean_a)
        sd = _sd_along(cov_a, line) + _sd_along(cov_b, line)
        far = ((mean_b - mean_a) * line).sum(axis=-1) > FAR * sd
        weigh = np.where(far, 1.0, weigh)
        a, b = a * weigh[..., None], b * weigh[..., None]
        both, count = a + b, len(self.zones)
        total = self.total * weigh
        gain: Floats = log_evidence(a) + log_evidence(b) - log_evidence(both)
        gain += log_share(a[..., 0]) + log_share(b[..., 0]) - log_share(both[..., 0])
        gain += log_zones(count + 1, total) - log_zones(count, total)
        unlike = gain > UNLIKE * np.minimum(a[..., 0], b[..., 0])
        return gain, (gain > least) & (far | unlike)

    def _valley_between(self, a: Floats, b: Floats, inside: NDArray[np.bool_]) -> float:
        """Log likelihood ratio of a valley between groups with sums ``a`` and ``b`` (6,), cells ``inside``."""
        key = min(a.tobytes() + b.tobytes(), b.tobytes() + a.tobytes())
        if key not in self.valleys:
            self.valleys[key] = self._valley(a, b, inside)
        return self.valleys[key]

    def _valley(self, a: Floats, b: Floats, inside: NDArray[np.bool_]) -> float:
        (mean_a, mean_b), cov = gaussians(np.stack([a, b]))
        difference = mean_b - mean_a
        line = _discriminant(cov[0] + cov[1], difference)
        sd_a, sd_b = _sd_along(cov, line).tolist()
        apart = float(line @ difference)
        if apart == 0.0:
            return 0.0  # around one point there is nothing in between
        # Clutter in the tube between the two belongs to the valley.
        mean = self.cells.mean
        along = (mean - mean_a) @ line
        aside = np.array([-line[1], line[0]])
        centre = mean_a + np.clip(along / apart, 0, 1)[:, None] * difference
        width = float(_sd_along(cov, aside).max())
        tube = (self.labels < 0) & (along > 0) & (along < apart) & (np.abs((mean - centre) @ aside) < 2 * width)
        chosen = inside | tube
        n = self.cells.sums[chosen, 0] / (1 + (a[0] + b[0]) / PAIR_EVENTS)
        sd = _sd_along(self.cells.spread[chosen], line)
        return valley(n, along[chosen], sd, -2 * sd_a, apart + 2 * sd_b)

    def _assign(self) -> None:
        """Each cell to the Gaussian, or the clutter, that explains its events best on average."""
        if not len(self.zones):
            return
        mean, cov = gaussians(self.zones)
        xx, xy, yy = cov.T
        determinant = xx * yy - xy * xy
        dx, dy = (self.cells.mean[:, None, :] - mean).transpose(2, 0, 1)
        inner = self.cells.spread[:, None, :]
        squared = yy * (dx * dx + inner[..., 0]) - 2 * xy * (dx * dy + inner[..., 1]) + xx * (dy * dy + inner[..., 2])
        score = (
            np.log(self.zones[:, 0] + 1) - np.log(2 * np.pi) - 0.5 * np.log(determinant) - 0.5 * squared / determinant
        )
        best = score.argmax(axis=1)
        explained = score[np.arange(len(best)), best] > np.log(self.clutter + 1) + self.log_density
        labels = np.where(explained, best, -1)
        if (labels != self.labels).any():
            self._set(labels)

    def _split(self) -> bool:
        """Split every group that is two zones; whether any was."""
        labels = self.labels.copy()
        keys = [zone.tobytes() for zone in self.zones]
        looked = [k for k in range(len(keys)) if keys[k] not in self.uncut]
        for k, part in zip(looked, self._cuts([np.flatnonzero(self.labels == k) for k in looked]), strict=True):
            if part is None:
                self.uncut.add(keys[k])
            else:
                labels[part] = labels.max() + 1
        changed = bool((labels != self.labels).any())
        if changed:
            self._set(labels)
        return changed

    def _cuts(self, groups: list[NDArray[np.intp]]) -> list[NDArray[np.intp] | None]:
        """Of each group of cells those on one side of the best straight cut, None when no cut makes two zones."""
        if not groups:
            return []
        orders = [(self.cells.mean[own] @ _DIRECTIONS).argsort(axis=0, kind="stable") for own in groups]
        sums = [np.cumsum(self.cells.sums[own][order], axis=0) for own, order in zip(groups, orders, strict=True)]
        left = np.concatenate([own[:-1] for own in sums])
        right = np.concatenate([own[-1:] - own[:-1] for own in sums])
        gain, clear = self._apart(left, right, self.hold_gain)
        result, end = list[NDArray[np.intp] | None](), 0
        for own, order in zip(groups, orders, strict=True):
            cuts = slice(end, end + len(own) - 1)
            result.append(self._best_cut(own, order, left[cuts], right[cuts], gain[cuts], clear[cuts]))
            end = cuts.stop
        return result

    def _best_cut(
        self, members: NDArray[np.intp], order: NDArray[np.intp], left: Floats, right: Floats, gain: Floats,
        clear: NDArray[np.bool_],
    ) -> NDArray[np.intp] | None:  # fmt: skip
        """The cells of ``members`` beyond the best cut that shows two zones. ``order``, and what is on either side of
        each cut: (cuts, directions)."""
        if len(members) < 2:
            return None
        inside = np.zeros(len(self.labels), dtype=np.bool_)
        inside[members] = True
        for angle in gain.max(axis=0).argsort(kind="stable")[::-1][:_CUTS_TRIED]:
            at = int(gain[:, angle].argmax())
            if gain[at, angle] > _GAIN_HOPELESS:
                wanted = (VALLEY_MIN if gain[at, angle] > self.hold_gain else VALLEY_ALONE) * self.hold
                if clear[at, angle] or self._valley_between(left[at, angle], right[at, angle], inside) >= wanted:
                    return np.asarray(members[order[at + 1 :, angle]])
        return None


def _discriminant(cov: Floats, difference: Floats) -> Floats:
    """Unit vectors (..., 2) along which groups with this summed covariance (..., 3) are told apart best."""
    x, y = difference[..., 0], difference[..., 1]
    line = np.stack([cov[..., 2] * x - cov[..., 1] * y, cov[..., 0] * y - cov[..., 1] * x], axis=-1)
    return np.asarray(line / (np.hypot(line[..., 0], line[..., 1]) + 1e-300)[..., None])


def _log_surplus(n: Floats, expected: Floats) -> Floats:
    """Log likelihood ratio of ``n`` events where ``expected`` were (Poisson), negative where there are fewer."""
    return np.asarray((n * np.log(n / expected) - n + expected) * np.sign(n - expected))


def _sd_along(cov: Floats, line: Floats) -> Floats:
    """Standard deviation along a unit vector of covariances (..., 3); never zero."""
    x, y = line[..., 0], line[..., 1]
    variance = cov[..., 0] * x**2 + 2 * cov[..., 1] * x * y + cov[..., 2] * y**2
    return np.asarray(np.sqrt(np.maximum(variance, 0) + 1e-6))
