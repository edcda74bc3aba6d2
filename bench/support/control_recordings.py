"""Recordings whose links are known beforehand: cameras that nothing joins, and streets.

Passages are drawn from a seed as columns and turned into events at the end. Times are seconds from
the beginning of the recording, which is cut off at its end, as a real one is.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from msgspec import Struct
from numpy.random import Generator
from numpy.typing import NDArray

from bench.support.recordings import CameraPair
from camtopod.arrays import Floats
from camtopod.records import Event

BEGINNING = 1.7e9
"""Time of the beginning of each recording, Unix seconds."""
BEFORE_SECONDS = 500.0
"""Traffic begins this long before the recording, so that its beginning is like the rest."""
STAY_SECONDS_MIN = 0.5
"""Least time in view, seconds."""
DOOR_RADIUS, DOOR_SD = 0.42, 0.02
"""Distance of the doors of a view from its middle, and spread around a door, widths of the
picture.
"""
GREEN_SHARE = 0.35
"""Share of a cycle in which a light is green, and of the green in which those that waited leave."""
BELL_SECONDS = 8.0
"""Mean time from a bell to an arrival, seconds."""
DAY_DEPTH = 0.9
"""Amplitude of the rhythm of the day, share of the mean rate."""
GROUP_SIZES = (2, 6)
"""Least and largest number of people of a group."""
GROUP_SECONDS = 3.0
"""Time within which a group passes, seconds."""
BATCH_SECONDS = 60.0
"""Time within which a batch has arrived at every camera, seconds."""


class Passages(Struct, eq=False):
    """Passages as columns, (n,); positions, 0 to 1, are nan where there are none."""

    camera: NDArray[np.int64]
    begin: Floats
    end: Floats
    x: Floats
    """Position at entry and at exit, (2, n); so is ``y``."""
    y: Floats


def events_of(passages: Passages, seconds: float, prefix: str = "c") -> list[Event]:
    """Return the events of passages within a recording of a length in seconds, by time.

    prefix: of the names of cameras, before their numbers.
    """
    count = len(passages.camera)
    t = np.concatenate((passages.begin, passages.end))
    rows = np.argsort(t, kind="stable")
    rows = rows[(t[rows] >= 0.0) & (t[rows] < seconds)]
    x, y = passages.x.ravel(), passages.y.ravel()
    events = []
    for row in rows.tolist():
        number = row % count
        has_position = not np.isnan(x[row])
        events.append(
            Event(
                f"{prefix}{passages.camera[number] + 1}",
                "entry" if row < count else "exit",
                BEGINNING + round(float(t[row]), 3),
                x=float(x[row]) if has_position else None,
                y=float(y[row]) if has_position else None,
                track=f"{prefix}.{number}",
            )
        )
    return events


class Traffic(Struct, frozen=True):
    """Traffic of cameras that nothing joins.

    per_minute: passages a minute at each camera.
    stay, spread: mean and standard deviation of the times in view, seconds.
    doors: places of each view where objects come and go; 0 without positions.
    rhythm: one of `RHYTHMS`.
    cycle: period of a rhythm that has one, or mean time between batches, seconds.
    """

    cameras: int = 4
    per_minute: float = 20.0
    minutes: float = 20.0
    stay: float = 12.0
    spread: float = 2.5
    doors: int = 0
    rhythm: str = "steady"
    cycle: float = 86.0

    @property
    def ways(self) -> dict[CameraPair, float]:
        """Transit time of each true link, seconds: there is none."""
        return {}

    def record(self, seed: int) -> list[Event]:
        """Return the events of a recording, by time."""
        chance = np.random.default_rng(seed)
        times = RHYTHMS[self.rhythm](self, chance)
        camera = np.repeat(np.arange(self.cameras), [len(camera_times) for camera_times in times])
        begin = np.concatenate(times)
        stay = np.maximum(chance.normal(self.stay, self.spread, len(begin)), STAY_SECONDS_MIN)
        x, y = _positions(camera, self.cameras, self.doors, chance)
        return events_of(Passages(camera, begin, begin + stay, x, y), 60.0 * self.minutes)


def _positions(
    camera: NDArray[np.int64], cameras: int, doors: int, chance: Generator
) -> tuple[Floats, Floats]:
    """Return x and y (2, n) of passages, each from one door of its camera (n,) to another."""
    if doors == 0:
        nowhere = np.full((2, len(camera)), np.nan)
        return nowhere, nowhere
    door = chance.integers(doors, size=len(camera))
    other_door = door + chance.integers(1, max(doors, 2), size=len(camera))
    turn = chance.uniform(0.0, 2 * np.pi, cameras)[camera]
    angle = turn + 2 * np.pi / doors * np.stack((door, other_door))
    x, y = (
        0.5 + DOOR_RADIUS * wave + chance.normal(0.0, DOOR_SD, angle.shape)
        for wave in (np.cos(angle), np.sin(angle))
    )
    return np.clip(x, 0.0, 1.0), np.clip(y, 0.0, 1.0)


def poisson_times(per_minute: float, seconds: float, chance: Generator) -> Floats:
    """Return the times of arrivals at random, from before the beginning until ``seconds``."""
    count = chance.poisson(per_minute * (seconds + BEFORE_SECONDS) / 60.0)
    return np.sort(chance.uniform(-BEFORE_SECONDS, seconds, count))


def _steady(traffic: Traffic, chance: Generator) -> list[Floats]:
    """Return arrival times by camera: at random."""
    seconds = 60.0 * traffic.minutes
    return [poisson_times(traffic.per_minute, seconds, chance) for _ in range(traffic.cameras)]


def _day(traffic: Traffic, chance: Generator) -> list[Floats]:
    """Return arrival times by camera, at a rate that goes up and down everywhere at once."""
    phase, seconds = chance.uniform(0.0, 2 * np.pi), 60.0 * traffic.minutes
    times = []
    for _ in range(traffic.cameras):
        t = poisson_times(2.0 * traffic.per_minute, seconds, chance)
        level = 0.5 * (1.0 + DAY_DEPTH * np.sin(2 * np.pi * t / seconds + phase))
        times.append(t[chance.random(len(t)) < level])
    return times


def _lights(traffic: Traffic, chance: Generator) -> list[Floats]:
    """Return arrival times by camera, each behind a light with its phase of the same cycle."""
    return [after_light(t, _changes(traffic, chance), chance) for t in _steady(traffic, chance)]


def _bells(traffic: Traffic, chance: Generator) -> list[Floats]:
    """Return arrival times by camera, soon after each of many bells at equal times.

    Trains, shuttles and lifts are of this kind, too.
    """
    times = []
    for _ in range(traffic.cameras):
        bells = _changes(traffic, chance)
        counts = chance.poisson(traffic.per_minute * traffic.cycle / 60.0, len(bells))
        times.append(np.repeat(bells, counts) + chance.exponential(BELL_SECONDS, int(counts.sum())))
    return times


def _changes(traffic: Traffic, chance: Generator) -> Floats:
    """Return the beginnings of all cycles, with a phase at random."""
    first = -BEFORE_SECONDS - chance.uniform(0.0, traffic.cycle)
    return np.arange(first, 60.0 * traffic.minutes + traffic.cycle, traffic.cycle)


def _groups(traffic: Traffic, chance: Generator) -> list[Floats]:
    """Return arrival times by camera, of groups that walk together past one camera."""
    low, high = GROUP_SIZES
    times = []
    for _ in range(traffic.cameras):
        rate = traffic.per_minute / ((low + high) / 2)
        t = poisson_times(rate, 60.0 * traffic.minutes, chance)
        t = np.repeat(t, chance.integers(low, high + 1, len(t)))
        times.append(t + chance.uniform(0.0, GROUP_SECONDS, len(t)))
    return times


def _batches(traffic: Traffic, chance: Generator) -> list[Floats]:
    """Return arrival times by camera, of batches that reach all cameras of a building at once."""
    batches = poisson_times(60.0 / traffic.cycle, 60.0 * traffic.minutes, chance)
    times = []
    for _ in range(traffic.cameras):
        counts = chance.poisson(traffic.per_minute * traffic.cycle / 60.0, len(batches))
        t = np.repeat(batches, counts)
        times.append(t + chance.uniform(0.0, BATCH_SECONDS, len(t)))
    return times


RHYTHMS: dict[str, Callable[[Traffic, Generator], list[Floats]]] = {
    "steady": _steady,
    "day": _day,
    "lights": _lights,
    "bells": _bells,
    "groups": _groups,
    "batches": _batches,
}
"""How arrivals are spread over time, by name."""


def after_light(t: Floats, changes: Floats, chance: Generator) -> Floats:
    """Return when objects that arrive at a light, at times ``t`` (n,), pass it.

    changes (m,): beginnings of its cycles. Each begins green; what arrives later waits for the
    next.
    """
    k = np.searchsorted(changes, t, side="right") - 1
    green = GREEN_SHARE * np.diff(changes)[k]
    starts = changes[k + 1] + chance.uniform(0.0, GREEN_SHARE, len(t)) * green
    return np.where(t - changes[k] < green, t, starts)


class Street(Struct, frozen=True):
    """A street with four views; half of what passes one goes on to the next.

    light: one of `LIGHTS`.
    per_minute: objects a minute that begin at each end; half as many begin at each other view.
    prefix: of the names of the cameras.
    """

    light: str = "none"
    per_minute: float = 6.0
    minutes: float = 240.0
    prefix: str = "c"

    @property
    def ways(self) -> dict[CameraPair, float]:
        """Transit time of each true link, seconds."""
        names = [f"{self.prefix}{k + 1}" for k in range(len(WAY_SECONDS) + 1)]
        ways = dict(zip(pairwise(names), WAY_SECONDS, strict=True))
        return ways | {(target, source): way for (source, target), way in ways.items()}

    def record(self, seed: int) -> list[Event]:
        """Return the events of a recording, by time."""
        chance = np.random.default_rng(seed)
        parts = []
        for forth in (True, False):
            for first in range(len(WAY_SECONDS) + 1):
                rate = self.per_minute * (1.0 if first == 0 else 1.0 - GOES_ON)
                t = poisson_times(rate, 60.0 * self.minutes, chance)
                changes = LIGHTS[self.light](first == 0, 60.0 * self.minutes, chance)
                if changes is not None:
                    t = after_light(t, changes, chance)
                parts += _along(t, first, forth, chance)
        columns = (np.concatenate(column, axis=-1) for column in zip(*parts, strict=True))
        return events_of(Passages(*columns), 60.0 * self.minutes, self.prefix)


WAY_SECONDS = (29.0, 48.0, 41.0)
"""Median times between the views of a street, seconds."""
WAY_SPREAD = 0.12
"""Standard deviation of the logarithm of a time between two views."""
GOES_ON = 0.5
"""Share of the objects that go on to the next view; the others turn off."""
STREET_STAY = (12.0, 2.5, 2.0)
"""Mean, standard deviation and least of the times in one view, seconds."""
ENDS_X, LANES_Y = (0.06, 0.94), (0.4, 0.7)
"""Where objects come and go, across the picture, and the lanes of both directions."""
ENDS_SD, LANES_SD = 0.015, 0.02
"""Spread of these positions."""
CYCLE_SECONDS, CYCLES_SECONDS = 86.0, (70.0, 100.0)
"""Cycle that lights have in common, and range of the cycles that differ, seconds."""

Columns = tuple[NDArray[np.int64], Floats, Floats, Floats, Floats]
"""The columns of `Passages`."""


def _along(t: Floats, first: int, forth: bool, chance: Generator) -> list[Columns]:
    """Return passages of objects that come to a view at times ``t`` (n,), then to those after it.

    first: number of the view, counted from the end at which the direction begins.
    forth: the direction.
    """
    ways, ends = (WAY_SECONDS, ENDS_X) if forth else (WAY_SECONDS[::-1], ENDS_X[::-1])
    mean, spread, least = STREET_STAY
    parts = []
    for view in range(first, len(ways) + 1):
        end = t + np.maximum(chance.normal(mean, spread, len(t)), least)
        x = np.array(ends)[:, None] + chance.normal(0.0, ENDS_SD, (2, len(t)))
        y = LANES_Y[0 if forth else 1] + chance.normal(0.0, LANES_SD, (2, len(t)))
        camera = np.full(len(t), view if forth else len(ways) - view)
        parts.append((camera, t, end, np.clip(x, 0.0, 1.0), np.clip(y, 0.0, 1.0)))
        if view < len(ways):
            end = end[chance.random(len(end)) < GOES_ON]
            t = end + ways[view] * np.exp(chance.normal(0.0, WAY_SPREAD, len(end)))
    return parts


def _cycles(lengths: Floats, chance: Generator) -> Floats:
    """Return the beginnings of cycles of the lengths (n, seconds), with a phase at random."""
    first = -BEFORE_SECONDS - chance.uniform(0.0, lengths[0])
    changes: Floats = first + np.concatenate(([0.0], np.cumsum(lengths)))
    return changes


def _count(seconds: float) -> int:
    """Return a number of cycles that lasts for a recording of a length in seconds."""
    return int((seconds + 2 * BEFORE_SECONDS) / CYCLES_SECONDS[0]) + 4


Light = Callable[[bool, float, Generator], Floats | None]
"""From whether the road begins at an end of the street, the length of the recording in seconds and
a generator: beginnings of the cycles of the road's light; None without a light.
"""


def _common(_end: bool, seconds: float, chance: Generator) -> Floats:
    return _cycles(np.full(_count(seconds), CYCLE_SECONDS), chance)


def _own(_end: bool, seconds: float, chance: Generator) -> Floats:
    return _cycles(np.full(_count(seconds), chance.uniform(*CYCLES_SECONDS)), chance)


def _drifting(_end: bool, seconds: float, chance: Generator) -> Floats:
    return _cycles(chance.uniform(*CYCLES_SECONDS, _count(seconds)), chance)


LIGHTS: dict[str, Light] = {
    "none": lambda _end, _seconds, _chance: None,
    "common": _common,
    "ends": lambda end, seconds, chance: _common(end, seconds, chance) if end else None,
    "own": _own,
    "drift": _drifting,
}
"""Lights at the roads into a street: none; all with one cycle; such at its ends only; each with a
cycle of its own; every cycle of each light another.
"""


class TwoSites(Struct, frozen=True):
    """Two streets that nothing joins, in one recording."""

    per_minute: float = 2.0
    minutes: float = 120.0

    @property
    def streets(self) -> tuple[Street, Street]:
        """Both streets."""
        return (
            Street("none", self.per_minute, self.minutes, "east"),
            Street("none", self.per_minute, self.minutes, "west"),
        )

    @property
    def ways(self) -> dict[CameraPair, float]:
        """Transit time of each true link, seconds."""
        east, west = self.streets
        return east.ways | west.ways

    def record(self, seed: int) -> list[Event]:
        """Return the events of a recording, by time."""
        events = [
            event for k, street in enumerate(self.streets) for event in street.record(2 * seed + k)
        ]
        return sorted(events, key=lambda event: event.t)


Control = Traffic | Street | TwoSites
"""A kind of recording: ``record(seed)`` makes one, ``ways`` are its true links."""
