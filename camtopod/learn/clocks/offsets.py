"""Clock offsets of the cameras, estimated from traffic alone.

Every path that is walked in both directions shows the difference of two clocks (`two_way_paths`).
The offsets are a robust fit to all differences of the network, under two assumptions: a path takes
about as long in both directions (how nearly is estimated from how well the differences agree), and
most clocks are right. A clock counts as wrong on clear evidence only.

If all traffic goes in one direction, a wrong clock cannot be told from a long path: the clock
counts as right and is marked as unidentified. So do those of cameras without positions, where all
paths between two cameras are one. In a part of the network that consists of two cameras only, the
clock of the camera with more events counts as right.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import coo_array

from camtopod.arrays import Bools, Floats, Ints
from camtopod.learn.clocks.correlogram import (
    ROWS_AT_ONCE,
    cache_friendly_order,
    correlograms,
    highest_peaks,
)
from camtopod.learn.clocks.two_way_paths import find_two_way_paths
from camtopod.learn.traffic import Arrivals, Departures, Scene

BIN_SECONDS = 1.0
"""Width of the bins of the correlograms of zone pairs."""
SCREENING_BIN_SECONDS = 4.0
"""Width of the bins of the correlograms of camera pairs, by which large networks are screened."""
ZONE_PAIRS_MAX = 6_000
"""Limit of the ordered zone pairs tested; of more, those of the most promising camera pairs."""
SPAN_MIN_SECONDS = 1800.0
"""Least duration of the data; with less, the null model is not known well enough to find peaks."""
CAMERAS_MAX = 250
"""Limit of the cameras whose clocks are estimated; the busiest count."""
ASYMMETRIES = (0.01, 0.02, 0.04, 0.08, 0.16)
"""Candidates for the asymmetry of the paths of a site, of which the likeliest is used.

Asymmetry is half the difference of the transit times in both directions, as a share of the transit
time, on average over paths.
"""
ASYMMETRY_PRIOR = 0.04
"""Prior asymmetry, which decides if there are too few paths for an estimate."""
SD_MIN_SECONDS = 0.05
"""Least standard deviation of a difference of two clocks."""
TURNING_SHARE = 0.2
"""Objects commonly turn around at a zone if more than this share of its exits are of objects that
entered there.
"""
SPREAD_SHARE_MAX = 0.75
"""Largest standard deviation of transit times, as a share of the transit time.

Beyond, there are several paths, which need not be used equally in both directions.
"""
SHORT_SECONDS = 2.0
"""Shorter transit times count as this long for `SPREAD_SHARE_MAX`."""
RIGHT_WEIGHT = 0.01
"""Cost of a second of offset, in standard deviations of disagreement of one difference."""
RIGHT_BEFORE_TRUST = 0.5
"""Additional trust in a clock that was right before; the trust in a clock is otherwise 1 to 2."""
OUTLIER_SD = 3.0
"""Disagreement, in standard deviations, at which a difference weighs half; also the degrees of
freedom of Student's t in `_with_asymmetry`.
"""
ROUNDS = 20
"""Iterations of the robust least squares."""
CLEAR_SD = 4.0
"""A clock is wrong if its offset exceeds this many of its standard deviations (and
`OFFSET_MIN_SECONDS`).
"""
OFFSET_MIN_SECONDS = 0.25
"""A clock is wrong if its offset exceeds this (and `CLEAR_SD` standard deviations)."""
MOVE_SD = 2.0
"""A known offset is replaced if a new estimate differs by this many standard deviations (and
`MOVE_MIN_SECONDS`).
"""
MOVE_MIN_SECONDS = 0.1
"""A known offset is replaced if a new estimate differs by this (and `MOVE_SD` standard deviations).
"""
RELEARN_SECONDS = 0.5
"""Change of an offset beyond which lags must be learned anew."""
REFRESH_SHARE = 0.2
"""Share of the events that must be new for a new estimate."""
DECIMALS = 3
"""Offsets are rounded to milliseconds, as the last bits differ between processors."""


class Clocks(NamedTuple):
    """The clocks of the cameras; each column has shape (cameras,).

    offset: clock offset in seconds, positive if the clock is fast.
    sd: standard deviation of the offset in seconds, inf if unknown.
    identified: True if there is a two-way path to another camera.
    """

    offset: Floats
    sd: Floats
    identified: Bools


class Difference(NamedTuple):
    """Difference of two clocks from one two-way path.

    a, b: indices of the cameras.
    ahead, sd: offset of the clock of ``b`` relative to that of ``a`` in seconds, if the path takes
        as long in both directions, and its standard deviation.
    transit: transit time in seconds.
    """

    a: int
    b: int
    ahead: float
    sd: float
    transit: float


class ClockState(Struct):
    """The saved state of a `ClockTracker`."""

    offset: Floats
    sd: Floats
    identified: Bools
    looked: int


def right_clocks(cameras: int) -> Clocks:
    """Return clocks of which nothing is known, so that all count as right."""
    return Clocks(np.zeros(cameras), np.full(cameras, np.inf), np.zeros(cameras, bool))


class ClockTracker:
    """The latest estimate of the clocks, updated once enough events are new."""

    def __init__(self) -> None:
        self.clocks = right_clocks(0)
        self._looked = 0

    def save(self) -> ClockState:
        """Return the state from which `load` continues."""
        return ClockState(*self.clocks, self._looked)

    def load(self, state: ClockState) -> None:
        """Continue from a saved state."""
        self.clocks, self._looked = Clocks(state.offset, state.sd, state.identified), state.looked

    def keep_cameras(self, kept: Bools) -> None:
        """Forget all cameras but those of the mask ``kept`` (cameras,), and renumber these."""
        offset, sd, identified = self.clocks
        # Cameras added since the last estimate are not among them.
        known = kept[: len(offset)]
        self.clocks = Clocks(offset[known], sd[known], identified[known])

    def update(self, scene: Scene, cameras: int, learned: int) -> bool:
        """Estimate the clocks again if there are new cameras or enough new events.

        scene: the events with uncorrected times.
        cameras: number of cameras.
        learned: number of events learned so far.

        Return True if an offset changes so much that lags must be learned anew (`RELEARN_SECONDS`).
        """
        # New cameras have right clocks so far.
        known = self.clocks
        if cameras > len(known.offset):
            more = right_clocks(cameras - len(known.offset))
            known = Clocks(*(np.concatenate(columns) for columns in zip(known, more, strict=True)))
        elif learned - self._looked < REFRESH_SHARE * (
            len(scene.departures.t) + len(scene.arrivals.t)
        ):
            return False

        # Change only what clearly differs.
        self.clocks, self._looked = (
            keep_unless_clear(known, estimate_clocks(scene, cameras, known)),
            learned,
        )
        return bool((np.abs(self.clocks.offset - known.offset) > RELEARN_SECONDS).any())


def estimate_clocks(scene: Scene, cameras: int, known: Clocks) -> Clocks:
    """Estimate the offsets of all clocks.

    scene: the events with uncorrected times.
    known: an earlier estimate.
    """
    departures, arrivals = scene.departures, scene.arrivals
    if (
        len(departures.t) == 0
        or len(arrivals.t) == 0
        or scene.last - scene.first < SPAN_MIN_SECONDS
    ):
        return right_clocks(cameras)

    # Solve for the offsets from the differences of pairs of clocks.
    weight = np.bincount(departures.camera, minlength=cameras) + np.bincount(
        arrivals.camera, minlength=cameras
    )
    camera_of = np.array([zone.camera for zone in scene.zones], np.int32)
    return solve_offsets(
        find_differences(departures, arrivals, camera_of, turning(scene), weight), weight, known
    )


def turning(scene: Scene) -> Bools:
    """Return True for zones (zones,) at which objects commonly turn around.

    These are the only zones of their cameras, and those where tracks show it (`TURNING_SHARE`).
    """
    camera_of = np.array([zone.camera for zone in scene.zones], np.int64)
    zones, p = len(scene.zones), scene.passages
    back = np.bincount(p.target[p.source == p.target], minlength=zones)
    only: Bools = np.bincount(camera_of)[camera_of] == 1
    return only | (back > TURNING_SHARE * np.maximum(np.bincount(p.target, minlength=zones), 1))


def find_differences(
    departures: Departures,
    arrivals: Arrivals,
    camera_of: Ints,
    turning: Bools,
    weight: NDArray[np.int64],
) -> list[Difference]:
    """Find all two-way paths, and return the difference of clocks that each shows.

    camera_of (zones,): camera of each zone.
    turning (zones,): True where objects commonly turn around.
    weight (cameras,): number of events of each camera.
    """
    # The pairs of the busiest cameras; if too many, the most promising ones.
    zones_of = [np.flatnonzero(camera_of == camera) for camera in range(len(weight))]
    busiest = np.sort(np.argsort(-weight, kind="stable")[:CAMERAS_MAX])
    pairs = [(int(a), int(b)) for k, a in enumerate(busiest) for b in busiest[k + 1 :]]
    pairs = [(a, b) for a, b in pairs if len(zones_of[a]) and len(zones_of[b])]
    if 2 * sum(len(zones_of[a]) * len(zones_of[b]) for a, b in pairs) > ZONE_PAIRS_MAX:
        pairs = _promising(departures, arrivals, pairs, zones_of)
    if not pairs:
        return []

    # Correlograms of all pairs of zones of each pair of cameras.
    left, came = (departures.t, departures.zone), (arrivals.t, arrivals.zone)
    seen = correlograms(left, came, len(camera_of), BIN_SECONDS)
    found = []
    a_of, b_of = np.array(pairs).T
    cameras_at_once = seen.at_once * len(zones_of) // len(camera_of)
    for a, b in (pairs[k] for k in cache_friendly_order(a_of, b_of, cameras_at_once)):
        u, v = (
            ends.ravel().astype(np.int32)
            for ends in np.meshgrid(zones_of[a], zones_of[b], indexing="ij")
        )

        # Their two-way paths.
        for k, way in find_two_way_paths(seen.correlograms_of(u, v), seen.correlograms_of(v, u)):
            if way.spread > SPREAD_SHARE_MAX * max(abs(way.transit), SHORT_SECONDS / BIN_SECONDS):
                continue
            # If objects turn around at both zones, one walk from u to v also looks like one from v
            # to u with a negative transit time.
            if turning[u[k]] and turning[v[k]]:
                continue
            sd = max(way.sd * BIN_SECONDS, SD_MIN_SECONDS)
            found.append(Difference(a, b, way.ahead * BIN_SECONDS, sd, way.transit * BIN_SECONDS))
    return sorted(found, key=lambda difference: (difference.a, difference.b))


def _promising(
    departures: Departures,
    arrivals: Arrivals,
    pairs: list[tuple[int, int]],
    zones_of: list[NDArray[np.intp]],
) -> list[tuple[int, int]]:
    """Return the camera pairs with the highest peaks, up to `ZONE_PAIRS_MAX` pairs of zones.

    The lower peak of the two directions counts.
    """
    # Highest peak of each pair of cameras.
    a, b = (np.array([pair[k] for pair in pairs], np.int32) for k in range(2))
    left, came = (departures.t, departures.camera), (arrivals.t, arrivals.camera)
    seen = correlograms(left, came, len(zones_of), SCREENING_BIN_SECONDS)
    peak, order = np.zeros(len(a)), cache_friendly_order(a, b, seen.at_once)
    for k in range(0, len(a), ROWS_AT_ONCE):
        some = order[k : k + ROWS_AT_ONCE]
        peak[some] = np.minimum(
            highest_peaks(seen.correlograms_of(a[some], b[some])),
            highest_peaks(seen.correlograms_of(b[some], a[some])),
        )

    # The best ones within the limit.
    order = np.argsort(-peak, kind="stable")
    size = np.cumsum([2 * len(zones_of[a[k]]) * len(zones_of[b[k]]) for k in order])
    return [pairs[k] for k in np.sort(order[(size <= ZONE_PAIRS_MAX)])]


def solve_offsets(found: list[Difference], weight: NDArray[np.int64], known: Clocks) -> Clocks:
    """Estimate the offsets of all clocks from differences between them.

    weight (cameras,): number of events of each camera.
    known: an earlier estimate.

    Differences do not determine the offsets alone: as many clocks as possible are right, first
    those that were right in ``known``, then those of busier cameras.
    """
    cameras = len(weight)
    clocks = right_clocks(cameras)
    if not found:
        return clocks

    # A robust first estimate, in which most offsets are zero.
    a, b = np.array([d.a for d in found]), np.array([d.b for d in found])
    ahead = np.array([d.ahead for d in found])
    trust = (
        1.0
        + weight / max(int(weight.sum()), 1)
        + RIGHT_BEFORE_TRUST * (known.identified & (known.offset == 0))
    )
    sd = _with_asymmetry(found, trust)
    clocks.identified[a] = clocks.identified[b] = True
    offset = _least_disagreement(a, b, ahead, sd, trust)

    # Least squares over the wrong clocks; the least clear one counts as right, until all are clear.
    wrong = clocks.identified & (np.abs(offset) > 1e-6)
    while True:
        offset, error = _least_squares(a, b, ahead, sd, wrong, offset)
        excess = np.where(
            wrong, np.abs(offset) / np.maximum(CLEAR_SD * error, OFFSET_MIN_SECONDS), np.inf
        )
        least = int(np.argmin(excess))
        if excess[least] > 1.0:
            break
        wrong[least] = False
    clocks.offset[:], clocks.sd[:] = offset, error
    return clocks


def _with_asymmetry(found: list[Difference], trust: Floats) -> Floats:
    """Return the standard deviation of each difference, including the asymmetry of paths.

    The asymmetry (`ASYMMETRIES`) is the likeliest given how well the differences agree.
    """
    a, b = np.array([d.a for d in found]), np.array([d.b for d in found])
    ahead, own, way = (
        np.array([getattr(d, name) for d in found]) for name in ("ahead", "sd", "transit")
    )

    # Degrees of freedom left beside the offsets, as a share of the differences.
    told = np.unique(np.concatenate((a, b)))
    more = max(len(found) - len(told) + 1, 0) / len(found)

    # Compare the posterior of the candidates.
    best, best_score = own, -np.inf
    for asymmetry in ASYMMETRIES:
        sd = np.hypot(own, asymmetry * way)
        offset = _least_disagreement(a, b, ahead, sd, trust)
        squared = ((ahead - offset[b] + offset[a]) / sd) ** 2
        # Student's t with OUTLIER_SD degrees of freedom: a path that differs from the path back is
        # an outlier.
        likelihood = more * float(
            np.sum(-np.log(sd)) - 2.0 * np.sum(np.log1p(squared / max(more, 1e-9) / OUTLIER_SD))
        )
        score = likelihood - 0.5 * np.log(asymmetry / ASYMMETRY_PRIOR) ** 2
        if score > best_score:
            best, best_score = sd, score
    return best


def _least_disagreement(
    a: NDArray[np.intp], b: NDArray[np.intp], ahead: Floats, sd: Floats, trust: Floats
) -> Floats:
    """Return the offsets (cameras,) with the least sum of absolute disagreements.

    a, b, ahead, sd (differences,): as in `Difference`.
    trust (cameras,): cost factor of an offset of each clock, so that most offsets are zero.
    """
    n, cameras = len(a), len(trust)

    # A linear programme. Variables: the offsets, their absolute values, and the disagreement of
    # each difference in standard deviations.
    cost = np.concatenate((np.zeros(cameras), RIGHT_WEIGHT * trust, np.ones(n)))

    # Constraints: disagreements and absolute values are at least either sign of their argument.
    k, c = np.arange(n), np.arange(cameras)
    above, below, left, right = k, n + k, 2 * n + c, 2 * n + cameras + c
    rows = np.concatenate((above, above, above, below, below, below, left, left, right, right))
    columns = np.concatenate(
        (b, a, 2 * cameras + k, b, a, 2 * cameras + k, c, cameras + c, c, cameras + c)
    )
    one, ones = 1.0 / sd, np.ones(cameras)
    values = np.concatenate(
        (one, -one, -np.ones(n), -one, one, -np.ones(n), ones, -ones, -ones, -ones)
    )
    matrix = coo_array(
        (values, (rows, columns)), shape=(2 * n + 2 * cameras, 2 * cameras + n)
    ).tocsr()
    limit = np.concatenate((ahead / sd, -ahead / sd, np.zeros(2 * cameras)))

    # Solve.
    bounds = [(None, None)] * cameras + [(0, None)] * (cameras + n)
    result = linprog(cost, A_ub=matrix, b_ub=limit, bounds=bounds, method="highs-ds")
    if not result.success:
        raise ArithmeticError(f"cannot estimate the clock offsets: {result.message}")
    offset: Floats = result.x[:cameras]
    return offset


def _least_squares(
    a: NDArray[np.intp],
    b: NDArray[np.intp],
    ahead: Floats,
    sd: Floats,
    wrong: Bools,
    offset: Floats,
) -> tuple[Floats, Floats]:
    """Estimate the offsets of the wrong clocks by robust least squares.

    a, b, ahead, sd (differences,): as in `Difference`.
    wrong (cameras,): True for clocks that may have an offset.
    offset (cameras,): first estimate.

    Return the offsets and the standard deviations, (cameras,) each. Differences that disagree with
    the others have little weight (`OUTLIER_SD`).
    """
    # Iteratively reweighted least squares.
    cameras = len(wrong)
    offset = np.where(wrong, offset, 0.0)
    free = np.flatnonzero(wrong)
    for _ in range(ROUNDS):
        disagreement = (ahead - offset[b] + offset[a]) / sd
        weight = 1.0 / sd**2 / (1.0 + (disagreement / OUTLIER_SD) ** 2)
        normal, pull = np.zeros((cameras, cameras)), np.zeros(cameras)
        for i, j, sign in ((a, a, 1.0), (b, b, 1.0), (a, b, -1.0), (b, a, -1.0)):
            np.add.at(normal, (i, j), sign * weight)
        np.add.at(pull, b, weight * ahead)
        np.add.at(pull, a, -weight * ahead)
        if len(free) == 0:
            break
        offset[free] = np.linalg.lstsq(normal[np.ix_(free, free)], pull[free])[0]

    # Standard deviations: of a right clock from its own differences, of the wrong ones together.
    error = np.full(cameras, np.inf)
    told = np.diag(normal) > 0
    error[told] = 1.0 / np.sqrt(np.diag(normal)[told])
    if len(free):
        error[free] = np.sqrt(
            np.maximum(np.diag(np.linalg.pinv(normal[np.ix_(free, free)], hermitian=True)), 0.0)
        )
    return offset, error


def keep_unless_clear(known: Clocks, found: Clocks) -> Clocks:
    """Return the known clocks with those offsets replaced that clearly differ in a new estimate.

    Clocks that are no longer identified count as right again.
    """
    away = np.abs(found.offset - known.offset)
    moves = ~found.identified | (away > np.maximum(MOVE_SD * found.sd, MOVE_MIN_SECONDS))
    offset: Floats = np.where(moves, found.offset, known.offset)
    sd: Floats = np.where(moves, found.sd, np.hypot(found.sd, away))
    return found._replace(offset=offset.round(DECIMALS), sd=sd)
