"""The rhythm of the arrivals at one zone, which the null model has to know.

Signals, trains, doors and groups make arrivals come in platoons. Under a rate that is even over
minutes, the departures of any zone in step with a platoon would look as if they had caused it. So
the null model of a zone is a sum of three parts: the even rate, the even rate in the zone's
strongest cycle, and the zone's own past arrivals, each of which raises the rate for a while (a
self-exciting process). Their shares are fitted to the arrivals by expectation maximisation. A
platoon then explains itself, but for its beginning.

`activity_rates` adds what other cameras tell of the site's activity, and what a zone's own past
tells at any age: where a light has no fixed cycle, the next platoon comes some cycle after this
one. It judges links only: in the fit, both would take what true ways explain.
"""

from __future__ import annotations

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.special import gammaincinv

from camtopod.arrays import Floats, Ints, rows_by_group
from camtopod.learn.traffic.background_rate import local_rates

CYCLE_SECONDS = (40.0, 150.0)
"""Shortest and longest cycle, those of traffic signals."""
HARMONICS = 3
"""Harmonics that describe the course of a cycle: platoons fill about a third of it."""
PAST_SECONDS = CYCLE_SECONDS[0]
"""Time constant with which the effect of an arrival decays: what lasts longer is a cycle."""
GAIN_NATS = 8.0
"""Least gain in log likelihood for which a zone has a rhythm, or a cycle among all frequencies; and
least evidence that a common cycle could make of no way at all: with less, none would be published.
"""
ITERATIONS = 50
"""Iterations of EM for the shares of the parts."""
ACTIVITY_SECONDS = 20.0
"""Time constant of the activity at other cameras around an arrival."""
PAST_AGES = np.arange(ACTIVITY_SECONDS, CYCLE_SECONDS[1] + ACTIVITY_SECONDS, ACTIVITY_SECONDS)
"""Limits of the ages at which earlier arrivals at the zone count apart, up to a cycle, seconds."""
ACTIVITY_PRIOR_EVENTS = 0.1
"""Weight of the usual activity, in events: few cameras tell little."""


def rhythm_rates(t: Floats, zone: Ints, even: Floats, zones: int) -> Floats:
    """Return the rate (n, 1/s) at each arrival under the null model, rhythm included.

    t (n,): times of arrivals in seconds, ascending.
    zone (n,): their zones, from 0 to ``zones`` - 1.
    even (n, 1/s): rate at each arrival without rhythm (`background_rate.local_rates`).

    Where a rhythm gains little, the rate is the even one.
    """
    parts = np.stack((even, even * _cycles(t, zone, zones), _own_past(t, zone, zones)))
    rate = _mixed(parts, zone, zones)
    gain = np.bincount(zone, np.log(rate / even), zones)
    return np.where((gain > GAIN_NATS)[zone], rate, even)


def activity_rates(t: Floats, zone: Ints, camera: Ints, rate: Floats) -> Floats:
    """Return the rate (n, 1/s) at each arrival if it also follows the site, and its own past.

    t (n,): times of arrivals in seconds, ascending.
    zone, camera (n,): their zones and cameras.
    rate (n, 1/s): rate at each arrival without the activity of other cameras (`rhythm_rates`).

    When a lecture ends, many arrive at all cameras, though none comes from another camera. The
    activity is the rate of arrivals at other cameras around an arrival, relative to the usual rate
    there. Its share at each zone, and that of earlier arrivals by their age, are the likeliest.
    """
    zones = int(zone.max(initial=-1)) + 1
    cameras = int(camera.max(initial=-1)) + 1
    whole_site = np.zeros(len(t), np.int32)
    around = _around(t, whole_site, 1) - _around(t, camera, cameras)
    usual = local_rates(t, whole_site, 1) - local_rates(t, camera, cameras)
    prior = ACTIVITY_PRIOR_EVENTS / ACTIVITY_SECONDS
    relative = (np.maximum(around, 0.0) + prior) / (np.maximum(usual, 0.0) + prior)
    parts = np.stack((rate, rate * relative, *_past_by_age(t, zone, zones)))
    return np.maximum(rate, _mixed(parts, zone, zones))


def _around(t: Floats, group: Ints, groups: int) -> Floats:
    """Return the rate (n, 1/s) of other arrivals of the group of each around its time."""
    rate = np.zeros(len(t))
    since = (t - t.min(initial=np.inf)) / ACTIVITY_SECONDS
    for rows in rows_by_group(group, groups):
        at = since[rows]
        before = np.logaddexp.accumulate(at)
        after = np.logaddexp.accumulate(-at[::-1])[::-1]
        rate[rows[1:]] += np.exp(before[:-1] - at[1:])
        rate[rows[:-1]] += np.exp(after[1:] + at[:-1])
    return rate / (2.0 * ACTIVITY_SECONDS)


def _mixed(parts: Floats, zone: Ints, zones: int) -> Floats:
    """Return the sum of parts of the rate (parts, n) with the likeliest shares at each zone."""
    number = np.maximum(np.bincount(zone, minlength=zones), 1.0)
    share = np.full((len(parts), zones), 1.0 / len(parts))
    for _ in range(ITERATIONS):
        parts_of_rate = share.take(zone, axis=1) * parts
        parts_of_rate /= parts_of_rate.sum(axis=0)
        share = np.stack([np.bincount(zone, part, zones) for part in parts_of_rate]) / number
    rate: Floats = (share[:, zone] * parts).sum(axis=0)
    return rate


def _cycles(t: Floats, zone: Ints, zones: int) -> Floats:
    """Return the relative rate (n,) in the strongest cycle of each arrival's zone; 1 without one.

    An arrival is left out of the course of the cycle at its own time.
    """
    relative = np.ones(len(t))
    if len(t) == 0:
        return relative

    # Time bins, four for a wave of the fastest harmonic; frequencies four times as fine as the time
    # can tell; the band of the cycles.
    shortest, longest = CYCLE_SECONDS
    step = shortest / (4 * HARMONICS)
    since = t - t[0]
    bins = int(since[-1] / step) + 1
    size = next_fast_len(4 * bins, real=True)
    band = np.arange(-(-size * step // longest), size * step // shortest + 1)
    band = band[band > 0].astype(np.intp)
    orders = np.arange(1, HARMONICS + 1)
    nats_needed = GAIN_NATS + np.log(max(len(band), 1))

    for rows in rows_by_group(zone, zones):
        # With fewer arrivals, no cycle can reach this power.
        if len(rows) * HARMONICS <= nats_needed or not len(band):
            continue

        # Power over the harmonics of each frequency, in units of the noise: that of other
        # frequencies, as clumps of arrivals have more than Poisson noise.
        counts = np.bincount((since[rows] / step).astype(np.intp), minlength=bins)
        power = np.abs(rfft(counts, size)) ** 2
        power = power[np.minimum(np.outer(orders, band), size // 2)].sum(axis=0)
        power *= gammaincinv(HARMONICS, 0.5) / max(float(np.median(power)), 1e-9)
        best = int(power.argmax())
        if power[best] - np.log1p(power[best]) < nats_needed:
            continue

        # The course of the cycle, by the other arrivals.
        angle = 2.0 * np.pi * band[best] / (size * step) * since[rows]
        wave = np.exp(1j * np.outer(orders, angle))
        other_waves = (wave.sum(axis=1, keepdims=True) - wave) / (len(rows) - 1)
        course = 1.0 + 2.0 * (other_waves.conj() * wave).real.sum(axis=0)
        relative[rows] = np.maximum(course, 0.0)
    return relative


def _own_past(t: Floats, zone: Ints, zones: int) -> Floats:
    """Return the rate (n, 1/s) that earlier arrivals at the zone of each arrival make.

    Each of them adds 1 / d exp(-lag / d), with d `PAST_SECONDS`.
    """
    rate = np.zeros(len(t))
    since = (t - t.min(initial=np.inf)) / PAST_SECONDS
    for rows in rows_by_group(zone, zones):
        log_sum = np.logaddexp.accumulate(since[rows])
        rate[rows[1:]] = np.exp(log_sum[:-1] - since[rows[1:]]) / PAST_SECONDS
    return rate


def _past_by_age(t: Floats, zone: Ints, zones: int) -> Floats:
    """Return the rates (ages, n, 1/s) that earlier arrivals at the zone of each arrival make.

    Each of them adds an even rate while its age is between two of `PAST_AGES`.
    """
    rate = np.zeros((len(PAST_AGES) - 1, len(t)))
    for rows in rows_by_group(zone, zones):
        at = t[rows]
        before = np.array([at.searchsorted(at - age) for age in PAST_AGES])
        rate[:, rows] = (before[:-1] - before[1:]) / np.diff(PAST_AGES)[:, None]
    return rate
