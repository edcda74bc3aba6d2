"""A made-up camera network at work: walkers, what the cameras report of them, and the truth.

Pure: the same settings give the same events. Walkers arrive as a Poisson process, follow a first-order chain
over zones, and each keeps a speed of their own; the disturbances of real installations are settings.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from camtopod.records import Event, Transit
from camtopod.sim.layout import WALKING_SPEED, Choices, Ints, Layout, make_layout
from camtopod.sim.truth import (
    CLUTTER,
    TRUTH_SCHEMA,
    Floats,
    TrueLink,
    TrueZone,
    Truth,
    pairs_of,
    transit_of,
)

PASSAGES_MAX = 100
"""A walker leaves the network after this many passages at the latest."""
WARM_UP_SECONDS = 1200.0
"""Walkers start this long before the recording, so that it begins with a full network."""
DAY_SECONDS = 86_400.0
SLOW_FACTOR = 0.45
TRANSIT_DRAWS = 20_000
CLUTTER_TRACK_SHARE = 0.5
LINGER_FACTOR = (5.0, 30.0)


class SimSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """What is simulated. Shares are in [0, 1]; times are seconds unless the name says otherwise."""

    cameras: int = 12
    hours: float = 1.5
    seed: int = 0
    start: float = 1_700_000_000.0
    """Event time at which the recording begins."""
    objects_per_second: float | None = None
    """Walkers that enter the network, by default 0.4 for 12 cameras and in proportion."""
    overlap_share: float = 0.25
    """Overlapping pairs of cameras, as a share of the number of cameras."""
    u_turn: float = 0.03
    """Probability of leaving a view where one came in."""
    speed_sd: float = 0.3
    """Spread of the walkers' speeds (log scale); a walker's own speed stays the same."""
    path_sd: float = 0.1
    """Spread (log scale) of one walker's time over one way."""
    missed: float = 0.1
    """Share of passages of which neither event is recorded."""
    clutter: float = 0.1
    """Share of the events that belong to nobody."""
    position_noise: float = 0.0
    """Standard deviation added to x and y, fraction of the image."""
    clock_sd: float = 0.0
    """Standard deviation of the cameras' clock offsets."""
    rhythm: float = 0.0
    """Amplitude of the day/night rhythm: the rate swings by this share."""
    rhythm_hours: float = 24.0
    group_share: float = 0.0
    """Share of the walkers with one to three companions a step behind."""
    loiterers: float = 0.0
    """Share of the walkers that linger 5 to 30 times as long in every view."""
    slow_share: float = 0.0
    """Share of the walkers at less than half the speed."""
    doors_closed: int = 0
    """Paths (both directions) that close."""
    close_after_hours: float | None = None
    """When they close, by default half-way."""
    lost: tuple[tuple[str, float, float], ...] = ()
    """Intervals (camera, from, to) in seconds after the start in which a camera reports nothing."""
    tracks: bool = True
    positions: bool = True


class _Passages(Struct):
    """Passages as columns: who, the number within the walk, zones and times of entry and exit."""

    walker: Ints
    number: Ints
    zone_in: Ints
    zone_out: Ints
    t_in: Floats
    t_out: Floats

    def take(self, index: NDArray[np.int64] | NDArray[np.bool_]) -> _Passages:
        return _Passages(*(getattr(self, name)[index] for name in self.__struct_fields__))


def simulate(settings: SimSettings) -> tuple[list[Event], Truth]:
    """Events sorted by time, and the truth. Raises ValueError for settings that make no sense."""
    _check(settings)
    structure, chance = (np.random.default_rng((settings.seed, part)) for part in (1, 2))
    layout = make_layout(settings.cameras, structure, settings.overlap_share, settings.u_turn)
    unknown = {camera for camera, _, _ in settings.lost} - set(layout.cameras)
    if unknown:
        raise ValueError(f"no camera {min(unknown)!r} to lose; there are {layout.cameras[0]} to {layout.cameras[-1]}")
    closed = _doors(layout, settings, structure)
    offsets = settings.clock_sd * structure.standard_normal(settings.cameras)
    passages = _walk(layout, settings, closed, chance)
    passages = _with_companions(passages, settings, chance)
    seconds = settings.hours * 3600.0
    passages = passages.take((passages.t_in >= 0) & (passages.t_out < seconds))
    recorded = passages.take(chance.random(len(passages.t_in)) >= settings.missed)
    events, owners = _report(recorded, layout, settings, offsets, chance)
    return events, _truth(layout, settings, closed, offsets, recorded, owners)


def _check(s: SimSettings) -> None:
    for name in ("missed", "group_share", "loiterers", "slow_share", "u_turn", "overlap_share", "rhythm"):
        if not 0 <= getattr(s, name) <= 1:
            raise ValueError(f"{name} is {getattr(s, name)}; it is a share from 0 to 1")
    if not 0 <= s.clutter < 1:
        raise ValueError(f"clutter is {s.clutter}; it is a share from 0 to below 1")
    for name in ("speed_sd", "path_sd", "position_noise", "clock_sd", "doors_closed", "seed"):
        if getattr(s, name) < 0:
            raise ValueError(f"{name} is {getattr(s, name)}; it cannot be negative")
    if s.cameras < 1 or not s.hours > 0 or not s.rhythm_hours > 0 or not math.isfinite(s.start):
        raise ValueError("cameras, hours and rhythm_hours must be positive, start a finite number")
    if s.objects_per_second is not None and not s.objects_per_second > 0:
        raise ValueError(f"objects_per_second is {s.objects_per_second}; it must be positive")


def _doors(layout: Layout, settings: SimSettings, rng: np.random.Generator) -> set[tuple[int, int]]:
    """The (from, to) that close: both directions of some unseen paths."""
    ways = layout.onward
    open_ = np.argwhere((ways.probability > 0) & (ways.metres > 0))
    paths = sorted({(int(min(u, v)), int(max(u, v))) for u, v in ((u, ways.target[u, k]) for u, k in open_)})
    chosen = rng.permutation(len(paths))[: settings.doors_closed]
    return {way for k in chosen for way in (paths[k], paths[k][::-1])}


def _arrivals(settings: SimSettings, rng: np.random.Generator) -> Floats:
    """Poisson arrival times; the rhythm thins a faster process."""
    rate = settings.objects_per_second or 0.4 * settings.cameras / 12
    begin, end = -WARM_UP_SECONDS, settings.hours * 3600.0
    times = np.sort(rng.uniform(begin, end, rng.poisson(rate * (1 + settings.rhythm) * (end - begin))))
    phase = 2 * np.pi * (times + settings.start) / (settings.rhythm_hours * DAY_SECONDS / 24)
    wanted = (1 - settings.rhythm * np.cos(phase)) / (1 + settings.rhythm)
    return times[rng.random(len(times)) < wanted]


def _walk(layout: Layout, settings: SimSettings, closed: set[tuple[int, int]], rng: np.random.Generator) -> _Passages:
    """All walks, one passage of every walker under way at a time."""
    t = _arrivals(settings, rng)
    walker = np.arange(len(t))
    zone = rng.choice(len(layout.camera), len(t), p=layout.arrivals)
    pace = 1 / (WALKING_SPEED * np.exp(settings.speed_sd * rng.standard_normal(len(t))))
    pace = np.where(rng.random(len(t)) < settings.slow_share, pace / SLOW_FACTOR, pace)
    linger = rng.uniform(*LINGER_FACTOR, len(t))
    linger = np.where(rng.random(len(t)) < settings.loiterers, linger, 1.0)
    closing = _closing_seconds(settings)
    open_, shut = layout.onward, layout.onward.without(closed)
    parts: list[_Passages] = []
    for number in range(PASSAGES_MAX):
        if len(t) == 0:
            break
        out, metres = _choose(layout.through, zone, rng)
        stay = metres * pace * _jitter(settings, rng, len(t)) * linger
        draw = rng.random(len(t))
        option = np.where(t < closing, _option(open_, out, draw), _option(shut, out, draw))
        goes = option >= 0
        ahead = np.where(goes, open_.metres[out, option], 0.0) * pace * _jitter(settings, rng, len(t))
        stay = np.maximum(stay, -1.25 * ahead)  # nobody is in the next view before being in this one
        parts.append(_Passages(walker, np.full(len(t), number), zone, out, t, t + stay))
        t, zone = (t + stay + ahead)[goes], open_.target[out, option][goes]
        walker, pace, linger = walker[goes], pace[goes], linger[goes]
    return _join(parts)


def _jitter(settings: SimSettings, rng: np.random.Generator, n: int) -> Floats:
    result: Floats = np.exp(settings.path_sd * rng.standard_normal(n))
    return result


def _option(choices: Choices, zone: Ints, draw: Floats) -> Ints:
    """Index of the option that a uniform draw picks in each zone's row, -1 for none."""
    index = (np.cumsum(choices.probability[zone], 1) <= draw[:, None]).sum(1)
    return np.where(index < choices.probability.shape[1], index, -1)


def _choose(choices: Choices, zone: Ints, rng: np.random.Generator) -> tuple[Ints, Floats]:
    """Target and metres where one option is always taken (rows sum to 1 up to rounding)."""
    total = choices.probability.sum(1)[zone]
    option = _option(choices, zone, rng.random(len(zone)) * total * (1 - 1e-12))
    return choices.target[zone, option], choices.metres[zone, option]


def _join(parts: list[_Passages]) -> _Passages:
    if not parts:
        none = np.zeros(0, dtype=np.int64)
        return _Passages(none, none, none, none, none.astype(float), none.astype(float))
    return _Passages(*(np.concatenate([getattr(part, name) for part in parts]) for name in _Passages.__struct_fields__))


def _with_companions(passages: _Passages, settings: SimSettings, rng: np.random.Generator) -> _Passages:
    """Groups: companions walk the leader's way, each a step (0.3 to 2 s) behind the one before."""
    walkers = int(passages.walker.max(initial=-1)) + 1
    size = np.where(rng.random(walkers) < settings.group_share, rng.integers(1, 4, walkers), 0)
    parts, fresh, behind = [passages], walkers, np.zeros(walkers)
    for place in range(1, 4):
        behind = behind + rng.uniform(0.3, 2.0, walkers)
        led = np.flatnonzero(size >= place)
        identity = np.full(walkers, -1)
        identity[led] = fresh + np.arange(len(led))
        fresh += len(led)
        mine = passages.take(identity[passages.walker] >= 0)
        late = behind[mine.walker]
        mine.walker, mine.t_in, mine.t_out = identity[mine.walker], mine.t_in + late, mine.t_out + late
        parts.append(mine)
    return _join(parts)


def _report(
    passages: _Passages, layout: Layout, settings: SimSettings, offsets: Floats, rng: np.random.Generator
) -> tuple[list[Event], Ints]:
    """What the cameras say, sorted by time, and (events, 3) owners: walker, number of the passage, zone."""
    n = len(passages.t_in)
    extra = round(settings.clutter / (1 - settings.clutter) * 2 * n)
    zone = np.concatenate([passages.zone_in, passages.zone_out])
    camera = np.concatenate([layout.camera[zone], rng.integers(0, settings.cameras, extra)])
    t = np.concatenate([passages.t_in, passages.t_out, rng.uniform(0, settings.hours * 3600.0, extra)])
    entry = np.concatenate([np.ones(n, bool), np.zeros(n, bool), rng.random(extra) < 0.5])
    place = np.concatenate([_positions(layout, zone, settings, rng), rng.random((extra, 2))])
    track = np.concatenate([np.tile(np.arange(n), 2), n + np.arange(extra)])
    track[2 * n :][rng.random(extra) >= CLUTTER_TRACK_SHARE] = -1
    owner = np.full((2 * n + extra, 3), CLUTTER)
    owner[: 2 * n] = np.column_stack([np.tile(passages.walker, 2), np.tile(passages.number, 2), zone])
    inside = ~_lost(camera, t, layout, settings)
    t = np.round(t + offsets[camera] + settings.start, 6)
    order = np.flatnonzero(inside)[np.argsort(t[inside], kind="stable")]
    tracks = _track_names(camera, track, order) if settings.tracks else [None] * len(order)
    xy = np.round(place, 4)
    events = [
        Event(
            camera=layout.cameras[camera[i]],
            kind="entry" if entry[i] else "exit",
            t=float(t[i]),
            x=float(xy[i, 0]) if settings.positions else None,
            y=float(xy[i, 1]) if settings.positions else None,
            track=name,
        )
        for i, name in zip(order, tracks, strict=True)
    ]
    return events, owner[order]


def _positions(layout: Layout, zone: Ints, settings: SimSettings, rng: np.random.Generator) -> Floats:
    """A point of each zone's normal distribution, inside the image."""
    spread = np.linalg.cholesky(layout.cov)
    at = layout.centre[zone] + np.einsum("nij,nj->ni", spread[zone], rng.standard_normal((len(zone), 2)))
    at += settings.position_noise * rng.standard_normal(at.shape)
    inside: Floats = np.clip(at, 0.0, 1.0)
    return inside


def _lost(camera: Ints, t: Floats, layout: Layout, settings: SimSettings) -> NDArray[np.bool_]:
    gone = np.zeros(len(t), dtype=bool)
    for name, begin, end in settings.lost:
        gone |= (camera == layout.cameras.index(name)) & (t >= begin) & (t < end)
    return gone


def _track_names(camera: Ints, track: Ints, order: Ints) -> list[str | None]:
    """Tracks numbered within their camera in the order they are first seen, as a tracker would."""
    names: dict[int, str] = {}
    counts: dict[int, int] = {}
    result: list[str | None] = []
    for i in order:
        key = int(track[i])
        if key >= 0 and key not in names:
            counts[camera[i]] = counts.get(camera[i], 0) + 1
            names[key] = str(counts[camera[i]])
        result.append(names[key] if key >= 0 else None)
    return result


def _truth(
    layout: Layout,
    settings: SimSettings,
    closed: set[tuple[int, int]],
    offsets: Floats,
    recorded: _Passages,
    owners: Ints,
) -> Truth:
    first = np.r_[0, np.flatnonzero(np.diff(layout.camera)) + 1]
    number = np.arange(len(layout.camera)) - first[layout.camera] + 1
    ids = [f"{layout.cameras[c]}/{k}" for c, k in zip(layout.camera, number, strict=True)]
    zones = [
        TrueZone(
            id=name,
            camera=layout.cameras[layout.camera[i]],
            x=round(float(layout.centre[i, 0]), 4) if settings.positions else None,
            y=round(float(layout.centre[i, 1]), 4) if settings.positions else None,
            cov=np.round(layout.cov[i], 7).tolist() if settings.positions else None,
        )
        for i, name in enumerate(ids)
    ]
    links = _links(layout, settings, closed, ids, recorded)
    return Truth(
        schema=TRUTH_SCHEMA,
        cameras=layout.cameras,
        zones=zones,
        links=links,
        pairs=pairs_of(links, {zone.id: zone.camera for zone in zones}),
        clock_offsets={c: round(float(o), 6) for c, o in zip(layout.cameras, offsets, strict=True)},
        identity=owners[:, 0].tolist(),
        passage=owners[:, 1].tolist(),
        zone=owners[:, 2].tolist(),
    )


def _links(
    layout: Layout, settings: SimSettings, closed: set[tuple[int, int]], ids: list[str], recorded: _Passages
) -> list[TrueLink]:
    """Every way with its probability, the time for it, and how often it was walked in the recording."""
    rng = np.random.default_rng((settings.seed, 3))
    pace = 1 / (WALKING_SPEED * np.exp(settings.speed_sd * rng.standard_normal(TRANSIT_DRAWS)))
    pace = np.where(rng.random(TRANSIT_DRAWS) < settings.slow_share, pace / SLOW_FACTOR, pace)
    forward = pace * _jitter(settings, rng, TRANSIT_DRAWS)
    metre = {True: transit_of(forward), False: transit_of(-forward)}
    closing = settings.start + _closing_seconds(settings)
    walked = _walked(recorded)
    links = []
    for inside, choices in ((True, layout.through), (False, layout.onward)):
        for u, k in np.argwhere(choices.probability > 0):
            v, metres = int(choices.target[u, k]), float(choices.metres[u, k])
            links.append(
                TrueLink(
                    from_=ids[u],
                    to=ids[v],
                    relation="visible" if inside else "unseen" if metres > 0 else "overlapped",
                    probability=round(float(choices.probability[u, k]), 6),
                    transitions=walked.get((inside, int(u), v), 0),
                    transit=_times(metre[metres > 0], abs(metres)),
                    closed_at=closing if not inside and (int(u), v) in closed else None,
                )
            )
    return links


def _closing_seconds(settings: SimSettings) -> float:
    hours = settings.hours / 2 if settings.close_after_hours is None else settings.close_after_hours
    return hours * 3600.0


def _times(one: Transit, metres: float) -> Transit:
    """A metre's figures scaled to a way's length."""
    return Transit(*(round(getattr(one, name) * metres, 4) for name in Transit.__struct_fields__))


def _walked(recorded: _Passages) -> dict[tuple[bool, int, int], int]:
    """How often (through a view?, from, to) happened with both ends recorded."""
    order = np.lexsort((recorded.number, recorded.walker))
    p = recorded.take(order)
    next_ = (p.walker[1:] == p.walker[:-1]) & (p.number[1:] == p.number[:-1] + 1)
    result: dict[tuple[bool, int, int], int] = {}
    for inside, u, v in (
        (True, p.zone_in, p.zone_out),
        (False, p.zone_out[:-1][next_], p.zone_in[1:][next_]),
    ):
        ways, counts = np.unique(np.column_stack([u, v]), axis=0, return_counts=True)
        result |= {(inside, int(a), int(b)): int(n) for (a, b), n in zip(ways, counts, strict=True)}
    return result
