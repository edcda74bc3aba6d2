"""The range of lags between views: how long before and after an exit objects appear elsewhere.

It is found in the newest stretch of the window (`find_lag_bins`): a joint fit over a far wider
range than is needed, and the lags of the transitions along its links. A site whose ways take
seconds gets a short range, as a long one costs time and lets chance in. Before an exit, an object
is elsewhere only where views overlap, and no longer than it stays in the view that it leaves.
"""

from __future__ import annotations

import math

import numpy as np

from camtopod.arrays import Bools, Floats, Singles
from camtopod.learn.association import (
    PAIRS_FEW,
    Fit,
    LagRanges,
    Problem,
    Traffic,
    find_candidates,
    fit_jointly,
    newest_within_limit,
)
from camtopod.learn.limits import (
    EVENT_PAIRS_MAX,
    LONGEST_SECONDS,
    RANGE_ARRIVALS_MAX,
)
from camtopod.learn.links import (
    TRANSITIONS_MIN,
    q_values,
    repeated_evidence,
)
from camtopod.learn.long_paths import LONG_SHARE_MAX
from camtopod.learn.traffic import Scene
from camtopod.topology import LAG_STEP, LagBins

SHORTEST_SECONDS = (5.0, 60.0)
"""Least range of lags before the exit, and after it."""
NEIGHBOURHOODS = 3
"""Parts of a site with too many pairs of zones for one fit (`PAIRS_FEW`) where the range is looked
for.
"""
NEIGHBOURHOOD_ZONES_MAX = 64
"""Zones of such a part."""
REACH_STEP = 0.7
"""Factor on the longest lag while too few of the newest events are within the limits."""
Q_MAX = 0.01
"""False discovery rate of the links that count."""
CONTRAST_MIN = 2.0
"""Least hazard at a lag that counts, over the median of the pair."""
COVERED = 0.95
"""Share of the links' transitions up to the longest lag that counts, and of the stays in views that
overlap; the others are strays.
"""
SPARE = 3.0
"""The range over that lag. Where transit times vary most, evenly per second (an exponential
distribution), 0.01 % are beyond three times their 95 % quantile; and a way may grow longer.
"""
NEWEST_SHARE = 0.25
"""Share of the stretch that must be covered as well as the whole: a way may just have changed."""


def find_lag_bins(scene: Scene, overlap: Bools, ranges: LagRanges | None = None) -> LagBins:
    """Return the bins of the lags between views, of a range that covers the links of a window.

    overlap (cameras, cameras): True where an object that leaves the first view may be in the second
        (`overlap_table`).
    ranges: delays of long paths, from which their lags count; None without.
    """
    if not (len(scene.departures.t) and len(scene.arrivals.t)):
        return shortest_bins()
    parts = neighbourhoods(scene) if len(scene.zones) ** 2 > PAIRS_FEW else [scene]
    problems = [newest_stretch(part, ranges) for part in parts]
    seconds = np.max(
        [
            extremes(problem, fit_jointly(problem, find_candidates(problem)))
            for problem in problems
            if len(problem.arrivals.t)  # none, if those of the newest moment are too many
        ],
        axis=0,
        initial=0.0,  # no part may have both departures and arrivals
    )
    shortest = np.array(SHORTEST_SECONDS)
    in_overlap = np.isin(scene.departures.camera, np.nonzero(overlap)[0])
    stays = (scene.departures.t - scene.departures.since)[in_overlap]
    if np.isfinite(stays).any():
        shortest[0] = max(shortest[0], np.quantile(stays[np.isfinite(stays)], COVERED))
    if ranges is not None:  # a peak at lag 0 has two sides
        shortest[0] = max(shortest[0], LAG_STEP * float(ranges.delay.max()))
    return _bins(*np.clip(SPARE * seconds, shortest, LONGEST_SECONDS).tolist())


def neighbourhoods(scene: Scene) -> list[Scene]:
    """Return the events of parts of a large site, each of cameras that follow on each other.

    A part has the busiest camera that is in none before, and those after whose departures its
    arrivals come most clearly more often than by chance.
    """
    ahead, longest = LONGEST_SECONDS
    departures, arrivals = scene.departures, scene.arrivals
    bins = LagBins(-ahead, longest)
    traffic = Traffic(Problem(departures, arrivals, bins, len(scene.zones), scene.last))
    view = np.array([zone.camera for zone in scene.zones])
    zone_counts = np.bincount(view)
    counts = np.bincount(arrivals.camera, minlength=len(zone_counts))
    parts = []
    for _ in range(NEIGHBOURHOODS):
        if not counts.any():
            break
        busiest = int(counts.argmax())
        excess = np.zeros(len(counts), np.float32)
        np.maximum.at(excess, view, traffic.excess(np.flatnonzero(view == busiest)).max(axis=1))
        excess[busiest] = np.inf
        order = np.argsort(-excess, kind="stable")
        cameras = order[np.cumsum(zone_counts[order]) <= NEIGHBOURHOOD_ZONES_MAX]
        counts[cameras] = 0
        is_near = np.isin(arrivals.camera, cameras)
        near_departures = departures.take(np.isin(departures.camera, cameras), is_near)
        part = scene._replace(departures=near_departures, arrivals=arrivals.take(is_near))
        if len(part.departures.t) and len(part.arrivals.t):
            parts.append(part)
    return parts


def shortest_bins() -> LagBins:
    """Return the bins of a site where nothing shows a longer range."""
    return _bins(*SHORTEST_SECONDS)


def newest_stretch(scene: Scene, ranges: LagRanges | None = None) -> Problem:
    """Return the newest events within the limits of a search, with the widest range they allow.

    ranges: as for `find_lag_bins`.
    """
    departures, arrivals = scene.departures, scene.arrivals
    cut = arrivals.t[-RANGE_ARRIVALS_MAX:][0]
    if len(arrivals.t) > RANGE_ARRIVALS_MAX:
        late = arrivals.t >= cut
        departures = departures.take(departures.t >= cut, late)
        arrivals = arrivals.take(late)
    ahead, longest = LONGEST_SECONDS
    shortest = SHORTEST_SECONDS[1]
    while True:
        bins = LagBins(-min(ahead, longest), longest)
        problem = Problem(departures, arrivals, bins, len(scene.zones), scene.last, ranges)
        problem = newest_within_limit(problem, EVENT_PAIRS_MAX)
        begin = problem.arrivals.t[:1]
        stretch = float(scene.last - begin[0]) if len(begin) else 0.0
        if longest <= max(shortest, LONG_SHARE_MAX * stretch):
            return problem
        longest = max(REACH_STEP * longest, shortest)


def extremes(problem: Problem, fit: Fit) -> tuple[float, float]:
    """Return how long before and after the exit the transitions of a fit's links come, seconds.

    Only lags count at which a link's hazard is well above its median over the range: what is spread
    over all lags, as chance is, tells nothing about how long the range has to be.
    """
    c = fit.candidates
    lag = c.lag - problem.delays(c.source, c.target)[c.pair]
    at = np.maximum(problem.bins.index(lag), 0)
    stands_out = fit.hazard[c.pair, at] > CONTRAST_MIN * _usual_hazards(problem, fit)[c.pair]
    is_linked = _linked(problem, fit)[c.pair] & stands_out
    begin = problem.arrivals.t[0]
    newest = problem.until - NEWEST_SHARE * (problem.until - begin)
    ahead = after = 0.0
    for rows in (is_linked, is_linked & (problem.arrivals.t[c.arrival] >= newest)):
        if rows.any():
            low, high = _quantiles(lag[rows], fit.responsibility[rows])
            ahead, after = max(ahead, -low), max(after, high)
    return ahead, after


def _usual_hazards(problem: Problem, fit: Fit) -> Singles:
    """Return the median hazard (P,) of each pair of zones over the seconds after the exit."""
    after = problem.bins.edges[:-1] >= 0
    hazard = fit.hazard[:, after]
    order = np.argsort(hazard, axis=1, kind="stable")
    seconds = np.cumsum(problem.bins.widths[after][order], axis=1)
    middle = (seconds < 0.5 * seconds[:, -1:]).sum(axis=1)
    rows = np.arange(len(hazard))
    usual: Singles = hazard[rows, order[rows, middle]]
    return usual


def _linked(problem: Problem, fit: Fit) -> Bools:
    """Return a mask (P,) of the pairs of zones that are links of a fit, more than once."""
    c = fit.candidates
    at = c.arrival / max(len(problem.arrivals.t), 1)
    nats = repeated_evidence(c.pair, fit.responsibility, fit.flat, at, len(c.source))
    q = q_values(nats, problem.zones**2)
    is_linked: Bools = (q <= Q_MAX) & (fit.counts.sum(axis=1) >= TRANSITIONS_MIN)
    return is_linked


def _quantiles(lag: Floats, weight: Floats) -> tuple[float, float]:
    """Return the least and the largest lag (seconds) but for strays: (1 - `COVERED`) of the weight.

    lag, weight (n,): lags in seconds and their weights; not empty.
    """
    order = np.argsort(lag, kind="stable")
    below = np.cumsum(weight[order], dtype=float)
    strays = (1.0 - COVERED) * below[-1]
    at = np.searchsorted(below, (strays, below[-1] - strays))
    low, high = lag[order[np.minimum(at, len(lag) - 1)]]
    return float(low), float(high)


def _bins(before: float, after: float) -> LagBins:
    """Return bins that cover lags up to ``before`` and ``after`` the exit, in seconds.

    The range ends a millisecond within the outermost bins' edges, so that these are whole.
    """
    edges = LagBins(-before, after).edges
    low, high = math.ceil(edges[0] * 1e3) + 1, math.floor(edges[-1] * 1e3) - 1
    return LagBins(low / 1e3, high / 1e3)
