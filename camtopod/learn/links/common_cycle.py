"""Evidence that a lag is a way, not the difference of two phases of a common cycle (METHOD 7).

Where zones follow one cycle (the lights of a street, bells, trains, lifts), departures of one zone
and arrivals of another come in platoons that are always the same lag apart, and however well the
rhythm of each zone is known, that lag looks like a way. What tells them apart is chance within a
cycle: on a way, a cycle with more departures, or earlier ones, has more arrivals, or earlier ones.
So the departures are moved by whole periods, earlier and later. If the zones have only the cycle in
common, these *copies* tell the arrivals as well as the true departures do.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.ndimage import median_filter
from scipy.special import gammaincc, gammaincinv

from camtopod.arrays import Bools, Floats, Ints, Singles, rows_by_group
from camtopod.learn.association import (
    Candidates,
    Em,
    Fit,
    Problem,
    adjust,
    find_candidates,
    fit_sparsely,
)
from camtopod.learn.lags import SMOOTHING_SD_BINS
from camtopod.learn.links.link_table import TRANSITIONS_MIN
from camtopod.learn.links.significance import PARTS
from camtopod.learn.traffic import GAIN_NATS, HARMONICS, Departures
from camtopod.topology import lag_smoothing_matrix

PERIOD_SECONDS = (20.0, 240.0)
"""Shortest and longest period: of lifts and bells, and of the slowest lights."""
BLOCK_SECONDS = 7200.0
"""Length of a block of time, within which a cycle has to keep its phase."""
NEIGHBOURS = 65
"""Frequencies around a period, four for each that the window tells apart, whose median is the noise
there: batches and trains without a timetable make long waves of all frequencies.
"""
PEAK_NATS = 20.0
"""Least significance of a period at each of two zones, as the negative log of a p-value, beside the
number of periods that are looked at.
"""
COPIES = (-3, -2, -1, 1, 2, 3)
"""The copies of the departures: whole periods by which they are moved."""
EXCESS_SD = (1.0, 3.0)
"""Least excess of candidates over the copies at the lags of a way, in standard deviations: at its
edges, and in the middle.
"""


def common_periods(problem: Problem, fit: Fit) -> Floats:
    """Return the common period (P, seconds) of the zones of each pair of a fit; nan without one.

    Pairs with too few transitions for a link have none.
    """
    # Powers of the frequencies and their harmonics at each zone, in units of the noise, summed over
    # blocks of time. A multiple of the cycle has fewer harmonics, a part of it less power.
    departures, arrivals, bins, *_ = problem
    first = min(departures.t[0], arrivals.t[0])
    seconds = max(problem.until - first, 1.0)  # a fast clock may leave less than nothing
    blocks = max(round(seconds / BLOCK_SECONDS), 1)
    shortest, longest = PERIOD_SECONDS
    step = shortest / (4 * HARMONICS)  # four time bins for a wave of the fastest harmonic
    steps = int(seconds / blocks / step) + 1
    size = next_fast_len(4 * steps, real=True)
    span = size * step
    # Seven periods at least: the departures and all copies differ.
    longest = min(longest, max(problem.until - departures.t[0], 1.0) / (1 + len(COPIES)))
    period = span / np.arange(int(span / longest) + 1, int(span / shortest) + 1)
    harmonics = np.outer(np.arange(1, HARMONICS + 1), np.round(span / period).astype(np.intp))
    noise = blocks * HARMONICS

    def powers(t: Floats, zone: Ints, zones: Ints) -> Floats:
        """Return the powers in the events at times ``t`` of each of ``zones`` (P,), (2, P, F).

        The first are relative to the usual power of all frequencies, the others also to that of the
        frequencies around each.
        """
        distinct_zones, row = np.unique(zones, return_inverse=True)
        rows = rows_by_group(zone, problem.zones)
        table = np.zeros((2, len(distinct_zones), len(period)))
        for power, line, place in zip(*table, distinct_zones.tolist(), strict=True):
            at = ((t[rows[place]] - first) / step).astype(np.int64)
            at = at[at < blocks * steps]  # by a wrong clock, some are after the window
            counts = np.bincount(at, minlength=blocks * steps).reshape(blocks, steps)
            waves = np.abs(rfft(counts - counts.mean(axis=1, keepdims=True), size)) ** 2
            power += waves.sum(axis=0)[harmonics].sum(axis=0)
            power *= gammaincinv(noise, 0.5) / max(float(np.median(power)), 1e-9)
            around = median_filter(power, NEIGHBOURS, mode="nearest") / gammaincinv(noise, 0.5)
            line += power / np.maximum(around, 1.0)
        return table[:, row]

    pairs = np.flatnonzero(fit.counts.sum(axis=1) >= TRANSITIONS_MIN)
    result = np.full(len(fit.counts), np.nan)
    if len(period) == 0 or len(pairs) == 0:
        return result
    c = fit.candidates
    departure_powers = powers(departures.t, departures.zone, c.source[pairs])
    arrival_powers = powers(arrivals.t, arrivals.zone, c.target[pairs])
    best = np.arange(len(pairs)), np.minimum(departure_powers, arrival_powers)[0].argmax(axis=1)
    departure_powers, arrival_powers = departure_powers[1][best], arrival_powers[1][best]
    nats = -np.log(
        np.maximum(gammaincc(noise, np.minimum(departure_powers, arrival_powers)), 1e-300)
    )

    # n departures and m arrivals in T seconds, of relative amplitudes a and b, and a kernel in step
    # with them over all lags gain n m lags / T (a b)^2 / 16 nats; power beyond noise is n a^2 / 4.
    gain = np.maximum(departure_powers - noise, 0.0) * np.maximum(arrival_powers - noise, 0.0)
    gain *= (bins.lag_max - bins.lag_min) / seconds
    clear = (nats >= PEAK_NATS + np.log(len(period))) & (gain >= GAIN_NATS)
    result[pairs] = np.where(clear, period[best[1]], np.nan)
    return result


def moved(problem: Problem, source: int, target: int, seconds: float, period: float) -> Candidates:
    """Return the candidates of one pair of zones after its departures are moved by ``seconds``.

    What is left of the window after its last whole ``period`` (seconds) does not count, and
    departures that leave the rest come back at its other end, in phase. Rows of arrivals count
    those of the zone alone.
    """
    d, arrivals = problem.departures, problem.arrivals.take(problem.arrivals.zone == target)
    first = d.t[0]
    turn = (problem.until - first) // period * period
    rows = np.flatnonzero((d.zone == source) & (d.t < first + turn))
    t = first + (d.t[rows] - first + seconds) % turn
    order = np.argsort(t, kind="stable")
    t, rows = t[order], rows[order]
    since = t - (d.t[rows] - d.since[rows])
    departures = Departures.without_arrivals(t, d.zone[rows], d.camera[rows], since, d.slow[rows])
    within = arrivals.take(arrivals.t < first + turn)
    return find_candidates(problem._replace(departures=departures, arrivals=within))


def _with_copies(
    problem: Problem, candidates: Candidates, pair: int, period: float
) -> Iterator[tuple[Candidates, Ints]]:
    """Yield the candidates of one pair of zones and their lag bins: the true ones, then each copy.

    candidates: those of all pairs; only their pairs of zones count.
    pair: number of the pair. period (seconds): its common period.
    """
    bins = problem.bins
    source, target = candidates.source[[pair]], candidates.target[[pair]]
    delay = problem.delays(source, target)
    for k in (0, *COPIES):
        copy = moved(problem, int(source[0]), int(target[0]), k * period, period)
        lag = np.clip(copy.lag.astype(float) - delay, bins.lag_min, bins.lag_max)
        yield copy, bins.index(lag)


def off_cycle(problem: Problem, candidates: Candidates, period: Floats) -> Bools:
    """Return a mask (M,) of the candidates at lags that a common cycle alone would not make.

    period (P, seconds): common period of each pair of zones, nan without one.
    """
    c, bins = candidates, problem.bins
    mask = np.ones((len(c.source), bins.size), np.bool_)
    for pair in np.flatnonzero(period > 0.0).tolist():
        copies = _with_copies(problem, c, pair, period[pair])
        counts = np.array([np.bincount(at, minlength=bins.size) for _, at in copies], float)
        mask[pair] = way_lags(counts[0], counts[1:])

    lag = c.lag.astype(float) - problem.delays(c.source, c.target)[c.pair]
    at = bins.index(np.clip(lag, bins.lag_min, bins.lag_max))
    able: Bools = mask[c.pair, at]
    return able


def way_lags(counts: Floats, copies: Floats) -> Bools:
    """Return a mask (bins,) of the lags at which a lag histogram clearly exceeds its copies.

    counts (bins,), copies (n, bins): candidates by lag.
    """
    # Noise is what the copies differ by: saturated platoons hardly differ from cycle to cycle.
    narrow, wide, *_ = SMOOTHING_SD_BINS
    spread = lag_smoothing_matrix(len(counts), narrow)
    smooth_copies = copies @ spread.T
    wider = lag_smoothing_matrix(len(counts), wide)
    noise = wider @ smooth_copies.var(axis=0, ddof=1) * (1.0 + 1.0 / len(copies))
    noise += (spread**2).sum(axis=1)  # that of one candidate a bin, where there are few
    excess = (spread @ counts - smooth_copies.mean(axis=0)) / np.sqrt(noise)

    # The stretches of bins above the cycle that are clearly above it somewhere.
    edge, middle = EXCESS_SD
    above = excess > edge
    stretch = np.cumsum(np.diff(above, prepend=False))
    clear = np.bincount(stretch, excess >= max(middle, float(excess.max()) / 3.0)) > 0.0
    mask: Bools = above & clear[stretch]
    return mask


def without_cycle(problem: Problem, fit: Fit) -> tuple[Fit, Floats]:
    """Return a joint fit without the candidates at lags that a common cycle alone would make.

    They would have arrivals of true ways. The second result is `common_periods` of the fit.
    """
    period = common_periods(problem, fit)
    able = off_cycle(problem, fit.candidates, period)
    if able.all():
        return fit, period
    em = Em(problem, fit.candidates, adjustment=adjust(problem, fit.candidates, fit.persistence))
    em.keep(able)
    em.run(em.start())
    fit = fit_sparsely(em)
    return fit, common_periods(problem, fit)


def evidence_against_cycle(
    problem: Problem,
    candidates: Candidates,
    hazard: Singles,
    share: Floats,
    outside: Floats,
    period: Floats,
) -> Floats:
    """Return the evidence (P, PARTS) of pairs of zones against a common cycle, by part of the time.

    With ``s_k`` the rate that the hazard of a pair gives at an arrival after departures moved by k
    periods, and b the rate of all else, it is the log (nats) of

        product over arrivals of  (b + s_0) / (mean over k, 0 included, of (b + s_k)),

    which has a mean of 1 if the true departures could be any of the copies, whatever hazard and
    rates are: an e-value, if the hazard is fitted on other events. It is 0 without a period.

    candidates: M candidates of the arrivals of the problem, of P pairs of zones.
    hazard (P, bins): hazards. share (M,): responsibilities under these.
    outside (zones,): share of the local rate of arrivals that no departure explains.
    period (P, seconds): common period of each pair of zones, nan without one.
    """
    c, arrivals = candidates, problem.arrivals
    arrival_share = np.bincount(c.arrival, share, minlength=len(arrivals.t))
    total_rate = outside[arrivals.zone] * arrivals.rate / np.maximum(1.0 - arrival_share, 1e-3)
    evidence = np.zeros((len(period), PARTS))
    part = np.arange(len(arrivals.t)) / max(len(arrivals.t), 1) * PARTS
    for pair in np.flatnonzero(period > 0.0).tolist():
        rows = np.flatnonzero(arrivals.zone == c.target[pair])
        pair_rows = np.flatnonzero(c.pair == pair)
        by_pair = np.bincount(c.arrival[pair_rows], share[pair_rows], minlength=len(arrivals.t))
        beside = (total_rate * np.maximum(1.0 - by_pair, 1e-3))[rows]

        copies = _with_copies(problem, c, pair, period[pair])
        rates = np.array([np.bincount(x.arrival, hazard[pair, at], len(rows)) for x, at in copies])
        nats = np.log((beside + rates[0]) / (beside + rates.mean(axis=0)))
        evidence[pair] = np.bincount(
            np.minimum(part[rows].astype(np.intp), PARTS - 1), nats, minlength=PARTS
        )
    return evidence
