"""Clocks: by how much each camera's is ahead, from traffic alone.

Every way that is walked in both directions says how two clocks differ (see `twoway`). These
differences are brought together over the whole network, robustly, under two assumptions: ways there
and back take about as long (how nearly so is learned from how well the differences agree), and most
clocks are right. A clock is only called wrong on clear evidence. Where all traffic goes one way,
nothing tells a wrong clock from a long way: the clock counts as right and is marked as
unidentified; and so it is between cameras without positions, where all ways are one. In a part of
the network that hangs together by two cameras only, the clock of the one with more events counts as
right.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import coo_array

from camtopod.arrays import Bools, Floats, Ints
from camtopod.learn.clocks.correlogram import ROWS_AT_ONCE, correlograms, highest, side_by_side
from camtopod.learn.clocks.two_way_paths import two_ways
from camtopod.learn.traffic import Arrivals, Departures, Scene

BIN_SECONDS = 1.0
SCREENING_BIN_SECONDS = 4.0
ZONE_PAIRS_MAX = 6_000
"""Ordered pairs of zones that are looked at closely; of larger networks, those of the most
promising cameras.
"""
SPAN_MIN_SECONDS = 1800.0
"""With less than this nothing is said: what stands out of chance cannot be told before chance is
known.
"""
CAMERAS_MAX = 250
"""The clocks of the busiest cameras up to this many are looked at."""
ASYMMETRIES = (0.01, 0.02, 0.04, 0.08, 0.16)
"""How unequal ways there and back may be, on average: half their difference, as a share of the way.
Which it is at a site is learned ...
"""
ASYMMETRY_PRIOR = 0.04
"""... and is about this where too few ways say."""
SD_MIN_SECONDS = 0.05
TURNING_SHARE = 0.2
"""Objects commonly leave where they entered when more than this share of those who leave there
do.
"""
SPREAD_SHARE_MAX = 0.75
"""Transit times that vary by more than this share of the way are of several ways, which need not be
the same back.
"""
SHORT_SECONDS = 2.0
"""Shorter ways count as this long there."""
RIGHT_WEIGHT = 0.01
"""A second of offset of one clock weighs as much as this many standard deviations of disagreement
of one way.
"""
STAYS_RIGHT = 0.5
"""How much more a clock is trusted that was right before."""
OUTLIER_SD = 3.0
ROUNDS = 20
CLEAR_SD = 4.0
"""A clock is wrong when its offset exceeds this many of its standard deviations ..."""
OFFSET_MIN_SECONDS = 0.25
"""... and this."""
MOVE_SD = 2.0
"""A known offset stays until the evidence is off by this many standard deviations ..."""
MOVE_MIN_SECONDS = 0.1
"""... and by this."""
RELEARN_SECONDS = 0.5
"""When an offset moves by more than this, what was known of lags is out of date."""
REFRESH_SHARE = 0.2
"""Clocks are looked at again when this share of the events is new."""
DECIMALS = 3
"""Offsets are rounded to milliseconds: the last bits differ between processors."""


class Clocks(NamedTuple):
    """Per camera (C,): how far its clock is ahead and the standard deviation of that (seconds; inf
    where unknown), and whether any way in both directions tells.
    """

    offset: Floats
    sd: Floats
    identified: Bools


class Difference(NamedTuple):
    """How far the clock of camera ``b`` is ahead of that of ``a`` if the way between them takes as
    long there as back: ``transit``. All in seconds.
    """

    a: int
    b: int
    ahead: float
    sd: float
    transit: float


class ClockState(Struct):
    """What a `ClockKeeper` knows."""

    offset: Floats
    sd: Floats
    identified: Bools
    looked: int


def right_clocks(cameras: int) -> Clocks:
    """Nothing is known."""
    return Clocks(np.zeros(cameras), np.full(cameras, np.inf), np.zeros(cameras, bool))


class ClockKeeper:
    """What is known of the clocks, looked at again from time to time."""

    def __init__(self) -> None:
        self.clocks = right_clocks(0)
        self._looked = 0

    def save(self) -> ClockState:
        """Everything `load` needs to go on from here."""
        return ClockState(*self.clocks, self._looked)

    def load(self, state: ClockState) -> None:
        """Go on from there."""
        self.clocks, self._looked = Clocks(state.offset, state.sd, state.identified), state.looked

    def keep(self, kept: Bools) -> None:
        """Forget all cameras but those that are ``kept`` (cameras,), which are numbered anew."""
        offset, sd, identified = self.clocks
        known = kept[: len(offset)]  # cameras that have come since the last look are not among them
        self.clocks = Clocks(offset[known], sd[known], identified[known])

    def look(self, scene: Scene, cameras: int, learned: int) -> bool:
        """Look again if there is enough new: ``scene`` by the cameras' own clocks, ``learned``
        events up to now.

        Returns whether a clock turns out to be off by so much from what was known that lags must be
        learned anew.
        """
        known = self.clocks
        if cameras > len(known.offset):
            more = right_clocks(cameras - len(known.offset))
            known = Clocks(*(np.concatenate(columns) for columns in zip(known, more, strict=True)))
        elif learned - self._looked < REFRESH_SHARE * (
            len(scene.departures.t) + len(scene.arrivals.t)
        ):
            return False
        self.clocks, self._looked = held(known, estimate_clocks(scene, cameras, known)), learned
        return bool((np.abs(self.clocks.offset - known.offset) > RELEARN_SECONDS).any())


def estimate_clocks(scene: Scene, cameras: int, known: Clocks) -> Clocks:
    """Offsets of all clocks from what left and came, by those clocks; ``known`` from an earlier
    look.
    """
    departures, arrivals = scene.departures, scene.arrivals
    if (
        len(departures.t) == 0
        or len(arrivals.t) == 0
        or scene.last - scene.first < SPAN_MIN_SECONDS
    ):
        return right_clocks(cameras)
    weight = np.bincount(departures.camera, minlength=cameras) + np.bincount(
        arrivals.camera, minlength=cameras
    )
    camera_of = np.array([zone.camera for zone in scene.zones], np.int32)
    return solve(
        differences(departures, arrivals, camera_of, turning(scene), weight), weight, known
    )


def turning(scene: Scene) -> Bools:
    """(zones,) where objects leave the view that entered it there: a camera's only zone, and what
    its tracks say.
    """
    camera_of = np.array([zone.camera for zone in scene.zones], np.int64)
    zones, p = len(scene.zones), scene.passages
    back = np.bincount(p.target[p.source == p.target], minlength=zones)
    only: Bools = np.bincount(camera_of)[camera_of] == 1
    return only | (back > TURNING_SHARE * np.maximum(np.bincount(p.target, minlength=zones), 1))


def differences(
    departures: Departures,
    arrivals: Arrivals,
    camera_of: Ints,
    turning: Bools,
    weight: NDArray[np.int64],
) -> list[Difference]:
    """What every way walked in both directions says. ``weight`` (cameras,): how busy they are."""
    zones_of = [np.flatnonzero(camera_of == camera) for camera in range(len(weight))]
    busiest = np.sort(np.argsort(-weight, kind="stable")[:CAMERAS_MAX])
    pairs = [(int(a), int(b)) for k, a in enumerate(busiest) for b in busiest[k + 1 :]]
    pairs = [(a, b) for a, b in pairs if len(zones_of[a]) and len(zones_of[b])]
    if 2 * sum(len(zones_of[a]) * len(zones_of[b]) for a, b in pairs) > ZONE_PAIRS_MAX:
        pairs = _promising(departures, arrivals, pairs, zones_of)
    if not pairs:
        return []
    left, came = (departures.t, departures.zone), (arrivals.t, arrivals.zone)
    seen = correlograms(left, came, len(camera_of), BIN_SECONDS)
    found = []
    a_of, b_of = np.array(pairs).T
    cameras_at_once = seen.at_once * len(zones_of) // len(camera_of)
    for a, b in (pairs[k] for k in side_by_side(a_of, b_of, cameras_at_once)):
        u, v = (
            ends.ravel().astype(np.int32)
            for ends in np.meshgrid(zones_of[a], zones_of[b], indexing="ij")
        )
        for k, way in two_ways(seen.of(u, v), seen.of(v, u)):
            if way.spread > SPREAD_SHARE_MAX * max(abs(way.transit), SHORT_SECONDS / BIN_SECONDS):
                continue
            # One walk from u to v then also shows as a way from v to u that ends before it begins.
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
    """The pairs of cameras that have most in common both ways, up to the limit of pairs of
    zones.
    """
    a, b = (np.array([pair[k] for pair in pairs], np.int32) for k in range(2))
    left, came = (departures.t, departures.camera), (arrivals.t, arrivals.camera)
    seen = correlograms(left, came, len(zones_of), SCREENING_BIN_SECONDS)
    peak, order = np.zeros(len(a)), side_by_side(a, b, seen.at_once)
    for k in range(0, len(a), ROWS_AT_ONCE):
        some = order[k : k + ROWS_AT_ONCE]
        peak[some] = np.minimum(
            highest(seen.of(a[some], b[some])), highest(seen.of(b[some], a[some]))
        )
    order = np.argsort(-peak, kind="stable")
    size = np.cumsum([2 * len(zones_of[a[k]]) * len(zones_of[b[k]]) for k in order])
    return [pairs[k] for k in np.sort(order[(size <= ZONE_PAIRS_MAX)])]


def solve(found: list[Difference], weight: NDArray[np.int64], known: Clocks) -> Clocks:
    """Offsets of all clocks (C,) from differences between them; ``weight`` (C,): how busy the
    cameras are.

    Only differences can be known: as many clocks as possible are right, rather those that were so
    far (``known``), then the busier.
    """
    cameras = len(weight)
    clocks = right_clocks(cameras)
    if not found:
        return clocks
    a, b = np.array([d.a for d in found]), np.array([d.b for d in found])
    ahead = np.array([d.ahead for d in found])
    trust = (
        1.0
        + weight / max(int(weight.sum()), 1)
        + STAYS_RIGHT * (known.identified & (known.offset == 0))
    )
    sd = _with_asymmetry(found, trust)
    clocks.identified[a] = clocks.identified[b] = True
    offset = _least_disagreement(a, b, ahead, sd, trust)
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
    """Standard deviation of each difference (D,) with what ways there and back differ by at this
    site: the likeliest given how well the differences agree.
    """
    a, b = np.array([d.a for d in found]), np.array([d.b for d in found])
    ahead, own, way = (
        np.array([getattr(d, name) for d in found]) for name in ("ahead", "sd", "transit")
    )
    told = np.unique(np.concatenate((a, b)))
    more = max(len(found) - len(told) + 1, 0) / len(
        found
    )  # what is left of the differences beside the offsets
    best, best_score = own, -np.inf
    for asymmetry in ASYMMETRIES:
        sd = np.hypot(own, asymmetry * way)
        offset = _least_disagreement(a, b, ahead, sd, trust)
        squared = ((ahead - offset[b] + offset[a]) / sd) ** 2
        # Student's t with OUTLIER_SD degrees of freedom or so: a way there by another route than
        # back is an outlier.
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
    """Offsets (C,) with the least sum of absolute disagreements, most of them zero: a linear
    programme.

    ``trust`` (C,): how much each clock is held to be right.
    """
    n, cameras = len(a), len(trust)
    # Variables: offsets, their absolute values, and the disagreement of each difference (in
    # standard deviations).
    cost = np.concatenate((np.zeros(cameras), RIGHT_WEIGHT * trust, np.ones(n)))
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
    bounds = [(None, None)] * cameras + [(0, None)] * (cameras + n)
    result = linprog(cost, A_ub=matrix, b_ub=limit, bounds=bounds, method="highs-ds")
    if not result.success:
        raise ArithmeticError(f"offsets of clocks: {result.message}")
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
    """Offsets (C,) of the wrong clocks, the others being right, and standard deviations (C,) of
    all: least squares in which differences that disagree with the rest count little.
    """
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
    error = np.full(cameras, np.inf)
    told = np.diag(normal) > 0
    error[told] = 1.0 / np.sqrt(np.diag(normal)[told])
    if len(free):
        error[free] = np.sqrt(
            np.maximum(np.diag(np.linalg.pinv(normal[np.ix_(free, free)], hermitian=True)), 0.0)
        )
    return offset, error


def held(known: Clocks, found: Clocks) -> Clocks:
    """What is known of the clocks after a new look: offsets stay as they are unless the evidence
    against is clear.

    Where there is no evidence any more, clocks count as right again.
    """
    away = np.abs(found.offset - known.offset)
    moves = ~found.identified | (away > np.maximum(MOVE_SD * found.sd, MOVE_MIN_SECONDS))
    offset: Floats = np.where(moves, found.offset, known.offset)
    sd: Floats = np.where(moves, found.sd, np.hypot(found.sd, away))
    return found._replace(offset=offset.round(DECIMALS), sd=sd)
