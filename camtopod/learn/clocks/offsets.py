"""Estimate the clock offset of each camera from traffic alone (METHOD 4).

Every path that objects take in both directions shows the difference of two clocks
(`two_way_paths`). The offsets are a robust fit to all differences of the site (`solve_offsets`),
under two assumptions: a path takes about as long in both directions, and most clocks are right. A
clock counts as wrong on clear evidence only. `ClockState` keeps the estimate from version to
version. If all traffic between two cameras goes in one direction, or a camera has no positions, a
wrong clock cannot be told from a long path: the clock counts as right and unidentified.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import block_array, csr_array, eye_array

from camtopod.arrays import Bools, Floats, Ints
from camtopod.learn.clocks.correlogram import (
    ROWS_AT_ONCE,
    Correlograms,
    cache_friendly_order,
    null_expectation,
    significant_peaks,
)
from camtopod.learn.clocks.two_way_paths import ROUNDS, find_two_way_paths
from camtopod.learn.lags import BIN_SECONDS
from camtopod.learn.traffic import EVENT_SD_SECONDS, Arrivals, Departures, Scene
from camtopod.topology import LAG_SECONDS_MIN

SCREENING_BIN_SECONDS = 4.0
"""Width of the bins of the correlograms of camera pairs, by which large networks are screened."""
ZONE_PAIRS_MAX = 6_000
"""Limit of the ordered zone pairs tested; of more, those of the most promising camera pairs."""
CAMERAS_MAX = 250
"""Limit of the cameras whose clocks are estimated; of more, those with the most events count."""
ASYMMETRIES = (0.32, 0.16, 0.08, 0.04, 0.02, 0.01)
"""Values that are tried for the asymmetry of the paths of a site; the likeliest is used. Asymmetry
is half the difference of the transit times in both directions, as a share of the transit time, on
average over paths.
"""
SPREAD_SHARE_MAX = 0.75
"""Largest standard deviation of transit times, as a share of the transit time. Beyond, there are
several paths, which need not be used equally in both directions. Transit times below
`LAG_SECONDS_MIN` count as that. So do negative ones, which overlapping views have: a negative lag
that varies is the dwell time in both views, which differs from one direction to the other.
"""
RIGHT_WEIGHT = 0.01
"""Cost of a second of clock offset in the first estimate (`_least_disagreement`), in standard
deviations of disagreement between the offsets and one measured difference.
"""
OUTLIER_SD = 3.0
"""Disagreement, in standard deviations, at which a difference has half its usual weight; also the
degrees of freedom of Student's t in `solve_offsets`.
"""
CLEAR_SD = 4.0
"""Least offset of a wrong clock, in standard deviations of the offset."""
REFRESH_SHARE = 0.2
"""Share of the window's events that must be new for a new estimate of the clocks."""
DECIMALS = 3
"""Offsets are rounded to milliseconds, as the last bits differ between processors."""


class Clocks(NamedTuple):
    """The clocks of the cameras; each column has shape (cameras,).

    offset: clock offset in seconds, positive if the clock is fast.
    sd: standard deviation of the offset in seconds, inf if unknown.
    is_identified: True if the clock can be told, by a two-way path to another camera.
    """

    offset: Floats
    sd: Floats
    is_identified: Bools


class Difference(NamedTuple):
    """Difference of two clocks as shown by one two-way path.

    a, b: indices of the two cameras.
    ahead: offset of the clock of ``b`` relative to the clock of ``a``, in seconds, assuming that
        the path takes equally long in both directions.
    sd: standard deviation of ``ahead`` in seconds.
    transit: transit time of the path in seconds.
    """

    a: int
    b: int
    ahead: float
    sd: float
    transit: float


def right_clocks(cameras: int) -> Clocks:
    """Return `Clocks` of cameras without any estimate: all offsets are 0."""
    return Clocks(np.zeros(cameras), np.full(cameras, np.inf), np.zeros(cameras, bool))


class ClockState(Struct):
    """The estimate of the clocks, which is renewed when enough events are new."""

    clocks: Clocks = field(default_factory=lambda: right_clocks(0))
    """The newest estimate."""
    learned: int = 0
    """Number of events learned at the last estimate."""

    def keep_cameras(self, mask: Bools) -> None:
        """Keep only the cameras of a mask (cameras,), and renumber them."""
        # Cameras added since the last estimate are not in ``clocks`` yet.
        clock_mask = mask[: len(self.clocks.offset)]
        offset, sd, is_identified = self.clocks
        self.clocks = Clocks(offset[clock_mask], sd[clock_mask], is_identified[clock_mask])

    def update(self, scene: Scene, cameras: int, events_learned: int, anew: bool = False) -> None:
        """Estimate the clocks again if there are new cameras or enough new events.

        scene: the labelled events, with uncorrected times.
        cameras: number of cameras.
        events_learned: number of events learned so far.
        anew: True to estimate them in any case.
        """
        # New cameras have right clocks so far.
        clocks = self.clocks
        if cameras > len(clocks.offset):
            new_clocks = right_clocks(cameras - len(clocks.offset))
            clocks = Clocks(
                *(np.concatenate(columns) for columns in zip(clocks, new_clocks, strict=True))
            )
        elif not anew and events_learned - self.learned < REFRESH_SHARE * (
            len(scene.departures.t) + len(scene.arrivals.t)
        ):
            return
        self.clocks = estimate_clocks(scene, cameras, clocks)
        self.learned = events_learned


def estimate_clocks(scene: Scene, cameras: int, clocks_before: Clocks) -> Clocks:
    """Estimate the offsets of all clocks from the events of the window.

    scene: the labelled events, with uncorrected times.
    cameras: number of cameras.
    clocks_before: an earlier estimate; clocks that were right before are more likely to be right
        now.
    """
    departures = scene.departures
    arrivals = scene.arrivals
    if len(departures.t) == 0 or len(arrivals.t) == 0:
        return right_clocks(cameras)

    # Solve for the offsets from the differences of pairs of clocks.
    weight = np.bincount(departures.camera, minlength=cameras) + np.bincount(
        arrivals.camera, minlength=cameras
    )
    camera_of = np.array([zone.camera for zone in scene.zones], np.int32)
    return solve_offsets(
        find_differences(departures, arrivals, camera_of, weight), weight, clocks_before
    )


def find_differences(
    departures: Departures,
    arrivals: Arrivals,
    camera_of: Ints,
    weight: NDArray[np.int64],
) -> list[Difference]:
    """Find all two-way paths of the site, and return the difference of two clocks that each shows.

    camera_of (zones,): camera of each zone.
    weight (cameras,): number of events of each camera.
    """
    # The pairs of the busiest cameras; if too many, the pairs with the highest peaks.
    zones_of = [np.flatnonzero(camera_of == camera) for camera in range(len(weight))]
    busiest = np.sort(np.argsort(-weight, kind="stable")[:CAMERAS_MAX])
    pairs = [(int(a), int(b)) for k, a in enumerate(busiest) for b in busiest[k + 1 :]]
    pairs = [(a, b) for a, b in pairs if len(zones_of[a]) and len(zones_of[b])]
    if 2 * sum(len(zones_of[a]) * len(zones_of[b]) for a, b in pairs) > ZONE_PAIRS_MAX:
        pairs = _promising(departures, arrivals, pairs, zones_of)
    if not pairs:
        return []

    # Correlograms of all pairs of zones of each pair of cameras.
    departure_events = (departures.t, departures.zone)
    arrival_events = (arrivals.t, arrivals.zone)
    pair_counts = Correlograms(departure_events, arrival_events, len(camera_of), BIN_SECONDS)
    differences = []
    a_of, b_of = np.array(pairs, np.int32).T
    cameras_at_once = pair_counts.at_once * len(zones_of) // len(camera_of)
    for a, b in (pairs[k] for k in cache_friendly_order(a_of, b_of, cameras_at_once)):
        # If both cameras have one zone only, a walk from u to v also looks like one back with a
        # negative transit time.
        if len(zones_of[a]) == len(zones_of[b]) == 1:
            continue
        u, v = (
            ends.ravel().astype(np.int32)
            for ends in np.meshgrid(zones_of[a], zones_of[b], indexing="ij")
        )

        # Their two-way paths.
        for path in find_two_way_paths(pair_counts.between(u, v), pair_counts.between(v, u)):
            if path.spread > SPREAD_SHARE_MAX * max(path.transit, LAG_SECONDS_MIN / BIN_SECONDS):
                continue
            sd = max(path.sd * BIN_SECONDS, EVENT_SD_SECONDS)
            differences.append(
                Difference(a, b, path.ahead * BIN_SECONDS, sd, path.transit * BIN_SECONDS)
            )
    return sorted(differences, key=lambda difference: (difference.a, difference.b))


def _promising(
    departures: Departures,
    arrivals: Arrivals,
    pairs: list[tuple[int, int]],
    zones_of: list[NDArray[np.intp]],
) -> list[tuple[int, int]]:
    """Return the camera pairs whose correlograms have the highest peaks.

    pairs: the pairs of cameras to choose from.
    zones_of: zones of each camera.

    Of the two directions the one with the lower peak counts. The pairs returned have at most
    `ZONE_PAIRS_MAX` ordered pairs of zones together.
    """
    # Highest peak of each pair of cameras.
    a, b = (np.array([pair[k] for pair in pairs], np.int32) for k in range(2))
    departure_events = (departures.t, departures.camera)
    arrival_events = (arrivals.t, arrivals.camera)
    pair_counts = Correlograms(
        departure_events, arrival_events, len(zones_of), SCREENING_BIN_SECONDS
    )
    peak = np.zeros(len(a))
    order = cache_friendly_order(a, b, pair_counts.at_once)
    for k in range(0, len(a), ROWS_AT_ONCE):
        rows = order[k : k + ROWS_AT_ONCE]
        ways = (pair_counts.between(*ends) for ends in ((a[rows], b[rows]), (b[rows], a[rows])))
        peak[rows] = np.min(
            [significant_peaks(counts, null_expectation(counts)).max(axis=1) for counts in ways],
            axis=0,
        )

    # The best ones within the limit.
    best = np.argsort(-peak, kind="stable")
    size = np.cumsum([2 * len(zones_of[a[k]]) * len(zones_of[b[k]]) for k in best])
    return [pairs[k] for k in np.sort(best[(size <= ZONE_PAIRS_MAX)])]


def solve_offsets(
    differences: list[Difference], weight: NDArray[np.int64], clocks_before: Clocks
) -> Clocks:
    """Estimate the offsets of all clocks from measured differences between pairs of them.

    differences: by how much the clocks of pairs of cameras differ.
    weight (cameras,): number of events of each camera.
    clocks_before: an earlier estimate.

    The differences alone leave the offsets undetermined by a constant. As many clocks as possible
    are taken to be right: with preference those that were right in ``clocks_before``, then those of
    cameras with many events.
    """
    cameras = len(weight)
    clocks = right_clocks(cameras)
    if not differences:
        return clocks

    a = np.array([difference.a for difference in differences])
    b = np.array([difference.b for difference in differences])
    ahead, own_sd, transit = np.array([difference[2:] for difference in differences]).T
    clocks.is_identified[a] = clocks.is_identified[b] = True

    # A robust first estimate, in which most offsets are zero, with the likeliest asymmetry. The
    # likelihood is that of Student's t with OUTLIER_SD degrees of freedom, as a path that differs
    # from the path back is an outlier; it counts as far as differences are redundant.
    trust = (
        1.0
        + weight / max(int(weight.sum()), 1)
        + (clocks_before.is_identified & (clocks_before.offset == 0))
    )
    redundant = max(len(differences) - int(clocks.is_identified.sum()) + 1, 0) / len(differences)
    best = -np.inf
    for asymmetry in ASYMMETRIES:
        spread = np.hypot(own_sd, asymmetry * transit)
        first = _least_disagreement(a, b, ahead, spread, trust)
        squares = ((ahead - (first[b] - first[a])) / spread) ** 2
        score = redundant * float(
            np.sum(-np.log(spread))
            - 2.0 * np.sum(np.log1p(squares / max(redundant, 1e-9) / OUTLIER_SD))
        )
        if score > best:
            best = score
            sd = spread
            offset = first

    # Least squares over the clocks that seem wrong. While any of them is not clearly wrong, count
    # the least clear one as right and repeat.
    wrong = np.abs(offset) > 1e-6
    while True:
        offset, error = _least_squares(a, b, ahead, sd, wrong, offset)
        clear = np.where(wrong, np.abs(offset) / error, np.inf)
        least = int(np.argmin(clear))
        if clear[least] > CLEAR_SD:
            break
        wrong[least] = False
    return Clocks(offset.round(DECIMALS), error, clocks.is_identified)


def _least_disagreement(a: Ints, b: Ints, ahead: Floats, sd: Floats, trust: Floats) -> Floats:
    """Return the offsets (cameras, seconds) with the least sum of absolute disagreements.

    The disagreement of a difference is that between its ``ahead`` and the offsets of its cameras,
    in standard deviations. Absolute offsets cost a little, too (`RIGHT_WEIGHT`), so that most are
    zero.

    a, b, ahead, sd (differences,): as in `Difference`.
    trust (cameras,): factor on the cost of an offset of each clock.
    """
    # A linear programme. Variables: the offsets, their absolute values, and the disagreement of
    # each difference in standard deviations; the latter two are at least either sign of their
    # argument.
    n, cameras = len(a), len(trust)
    rows = np.tile(np.arange(n), 2)
    signs = np.concatenate((-1.0 / sd, 1.0 / sd))
    incidence = csr_array((signs, (rows, np.concatenate((a, b)))), shape=(n, cameras))
    clock = eye_array(cameras)
    matrix = block_array(
        [
            [incidence, None, -eye_array(n)],
            [-incidence, None, -eye_array(n)],
            [clock, -clock, None],
            [-clock, -clock, None],
        ],
        format="csr",
    )
    result = linprog(
        np.concatenate((np.zeros(cameras), RIGHT_WEIGHT * trust, np.ones(n))),
        A_ub=matrix,
        b_ub=np.concatenate((ahead / sd, -ahead / sd, np.zeros(2 * cameras))),
        bounds=[(None, None)] * cameras + [(0, None)] * (cameras + n),
        method="highs-ds",
    )
    if not result.success:
        raise ArithmeticError(f"cannot estimate the clock offsets: {result.message}")
    offset: Floats = result.x[:cameras]
    return offset


def _least_squares(
    a: Ints, b: Ints, ahead: Floats, sd: Floats, wrong: Bools, offset: Floats
) -> tuple[Floats, Floats]:
    """Estimate the offsets of the wrong clocks by robust least squares; the others are 0.

    a, b, ahead, sd (differences,): as in `Difference`.
    wrong (cameras,): True for clocks that may have an offset.
    offset (cameras, seconds): first estimate.

    Return the offsets and their standard deviations, (cameras, seconds) each. Differences that
    disagree with the others have little weight (`OUTLIER_SD`).
    """
    # Iteratively reweighted least squares, until no offset changes by the precision kept.
    cameras = len(wrong)
    offset = np.where(wrong, offset, 0.0)
    free = np.flatnonzero(wrong)
    number = np.cumsum(wrong) - 1
    is_free = wrong[a] & wrong[b]
    cell = number[a[is_free]] * len(free) + number[b[is_free]]
    for _ in range(ROUNDS):
        disagreement = (ahead - (offset[b] - offset[a])) / sd
        weight = 1.0 / sd**2 / (1.0 + (disagreement / OUTLIER_SD) ** 2)
        precision = np.bincount(a, weight, cameras) + np.bincount(b, weight, cameras)
        towards = np.bincount(b, weight * ahead, cameras) - np.bincount(a, weight * ahead, cameras)
        between = np.bincount(cell, weight[is_free], len(free) ** 2).reshape(len(free), len(free))
        normal = np.diag(precision[free]) - between - between.T
        inverse = np.linalg.pinv(normal, hermitian=True)
        before = offset[free]
        offset[free] = inverse @ towards[free]
        if np.abs(offset[free] - before).max(initial=0.0) < 0.1 * 10.0**-DECIMALS:
            break

    # Standard deviations: of each right clock from its differences alone, of the wrong clocks from
    # the inverse of the normal matrix.
    error = np.full(cameras, np.inf)
    error[precision > 0] = 1.0 / np.sqrt(precision[precision > 0])
    error[free] = np.sqrt(np.maximum(np.diag(inverse), 0.0))
    return offset, error
