"""Walkers of a simulated network: when they come, where they go, and how long it takes."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from camtopod.arrays import Floats, Longs
from camtopod.sim.layout import WALKING_SPEED, Choices, Layout
from camtopod.sim.settings import SimSettings

WARM_UP_SECONDS = 1200.0
"""Walkers start this long before the recording, so that it begins with a full network."""
LINGER_FACTOR = (5.0, 30.0)
"""Range of the factor on the dwell times of loiterers."""


class Passages(Struct):
    """Passages as columns: walker, number within the walk, zones and times of entry and exit."""

    walker: Longs
    number: Longs
    zone_in: Longs
    zone_out: Longs
    t_in: Floats
    t_out: Floats

    def take(self, index: Longs | NDArray[np.bool_]) -> Passages:
        """Return those at ``index`` (numbers in any order), or where a boolean ``index`` (n,) is
        true.
        """
        return Passages(*(getattr(self, name)[index] for name in self.__struct_fields__))


def walk(layout: Layout, settings: SimSettings, rng: np.random.Generator) -> Passages:
    """Return all passages; each turn of the loop simulates one passage of every walker still under
    way.
    """
    onward = layout.onward
    early_choices = onward.without(layout.opening)
    late_choices = onward.without(layout.closing)

    # Who comes, when, where, and how fast.
    t = _arrivals(settings, rng)
    walker = np.arange(len(t))
    zone = rng.choice(len(layout.camera), len(t), p=layout.arrivals)
    pace = seconds_per_metre(settings, rng, len(t))
    linger = rng.uniform(*LINGER_FACTOR, len(t))
    linger = np.where(rng.random(len(t)) < settings.loiterers, linger, 1.0)

    # Passage by passage until all have left, or have made a hundred.
    parts: list[Passages] = []
    for number in range(100):
        out, metres = _choose(layout.through, zone, rng)
        stay = metres * pace * jitter(rng, len(t)) * linger
        draw = rng.random(len(t))
        late = t >= settings.half_way
        option = np.where(late, _option(late_choices, out, draw), _option(early_choices, out, draw))
        goes = option >= 0
        ahead = np.where(goes, onward.metres[out, option], 0.0) * pace * jitter(rng, len(t))
        # A walker cannot enter the next view before this one.
        stay = np.maximum(stay, -1.25 * ahead)
        parts.append(Passages(walker, np.full(len(t), number), zone, out, t, t + stay))
        t = (t + stay + ahead)[goes]
        zone = onward.target[out, option][goes]
        walker = walker[goes]
        pace = pace[goes]
        linger = linger[goes]
    return Passages(
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in Passages.__struct_fields__
        )
    )


def seconds_per_metre(settings: SimSettings, rng: np.random.Generator, n: int) -> Floats:
    """Return the pace of ``n`` walkers, seconds per metre; they differ by 0.3 (log scale)."""
    pace = 1 / (WALKING_SPEED * np.exp(0.3 * rng.standard_normal(n)))
    return np.where(rng.random(n) < settings.slow_share, pace / 0.45, pace)


def _arrivals(settings: SimSettings, rng: np.random.Generator) -> Floats:
    """Return Poisson arrival times; the rhythm thins a faster process."""
    rate = settings.objects_per_second or 0.4 * settings.cameras / 12
    begin = -WARM_UP_SECONDS
    end = settings.hours * 3600.0
    times = np.sort(
        rng.uniform(begin, end, rng.poisson(rate * (1 + settings.rhythm) * (end - begin)))
    )
    phase = 2 * np.pi * (times + settings.start) / (settings.rhythm_hours * 3600.0)
    acceptance = (1 - settings.rhythm * np.cos(phase)) / (1 + settings.rhythm)
    return times[rng.random(len(times)) < acceptance]


def jitter(rng: np.random.Generator, n: int) -> Floats:
    """Return a random factor (log scale, 0.1) on the usual time of each of ``n`` paths."""
    return np.exp(0.1 * rng.standard_normal(n))


def _option(choices: Choices, zone: Longs, draw: Floats) -> Longs:
    """Return the index of the option that a uniform draw picks in each zone's row, -1 for none."""
    index = (np.cumsum(choices.probability[zone], 1) <= draw[:, None]).sum(1)
    return np.where(index < choices.probability.shape[1], index, -1)


def _choose(choices: Choices, zone: Longs, rng: np.random.Generator) -> tuple[Longs, Floats]:
    """Return target and metres where one option is always taken (rows sum to 1 up to rounding)."""
    total = choices.probability.sum(1)[zone]
    option = _option(choices, zone, rng.random(len(zone)) * total * (1 - 1e-12))
    return choices.target[zone, option], choices.metres[zone, option]
