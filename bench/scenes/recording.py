"""From passages through views to reports of cameras: tracker faults, events, ground truth.

Used by the scenes in which people or vehicles move on a plan (`hall`, `crowd`, `walkway`, `road`).
Times are seconds since the recording's start; positions are fractions of the image.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
from msgspec import Struct

from camtopod.arrays import Bools, Floats, Longs
from camtopod.records import Event, Pair
from camtopod.sim.reports import events_of
from camtopod.sim.truth import (
    CLUTTER,
    TRUTH_SCHEMA,
    TrueLink,
    TrueZone,
    Truth,
    walked_links,
    zone_at,
)

PAIR_WALKS_MIN = 3
"""Least number of walks from one camera to another that relates them in the ground truth."""
GAP_SECONDS = (0.5, 3.0)
"""Range of the time from a tracker's loss of a person until its new track, seconds."""
GHOST_SECONDS, GHOST_SECONDS_SD = 2.0, 0.8
"""Median length of clutter tracks, seconds, and its spread (log scale)."""
GHOST_METRES_SD = 0.1
"""Spread of the lengths of clutter tracks, fraction of the image."""


class Faults(Struct, frozen=True, forbid_unknown_fields=True):
    """Faults of the cameras. Shares are in [0, 1)."""

    missed: float = 0.07
    """Share of the passages that are not recorded."""
    clutter: float = 0.05
    """Share of the recorded passages that belong to no object."""
    broken_every: float = 60.0
    """Mean seconds in view between two losses of a person by the tracker."""
    short: float = 0.5
    """Passages of fewer seconds are not recorded."""
    noise: float = 0.01
    """Standard deviation of positions, fraction of the image."""


class Sightings(Struct):
    """Passages as columns.

    person, camera, zone_in, zone_out (n,): numbers; zones are -1 where undefined.
    t_in, t_out (n,), seconds.
    at_in, at_out (n, 2), fractions of the image, or nan.
    """

    person: Longs
    camera: Longs
    t_in: Floats
    t_out: Floats
    at_in: Floats
    at_out: Floats
    zone_in: Longs
    zone_out: Longs

    def take(self, index: Longs | Bools) -> Sightings:
        """Return the passages at ``index``, numbers in any order or a mask (n,)."""
        return Sightings(*(getattr(self, name)[index] for name in self.__struct_fields__))

    def sorted(self) -> Sightings:
        """Return the passages by person, then by time of entry."""
        return self.take(np.lexsort((self.camera, self.t_in, self.person)))


def check(settings: Struct, faults: Faults, positive: tuple[str, ...]) -> None:
    """Raise ValueError for a setting that must be positive and is not, and for invalid faults."""
    for name in positive:
        if not getattr(settings, name) > 0:
            raise ValueError(f"{name} is {getattr(settings, name)}; it must be positive")
    for name in ("missed", "clutter"):
        if not 0 <= getattr(faults, name) < 1:
            raise ValueError(f"{name} is {getattr(faults, name)}; it is a share from 0 to below 1")
    if not faults.broken_every > 0 or faults.short < 0 or faults.noise < 0:
        raise ValueError("broken_every must be positive, short and noise cannot be negative")


def join(parts: list[Sightings]) -> Sightings:
    """Concatenate tables (at least one)."""
    return Sightings(
        *(np.concatenate([getattr(p, name) for p in parts]) for name in Sightings.__struct_fields__)
    )


def clipped(tracks: Sightings, on_air: list[tuple[int, float, float]]) -> Sightings:
    """Cut passages to the intervals (camera, from, to) in which cameras report."""
    parts = []
    for camera, begin, end in on_air:
        part = tracks.take((tracks.camera == camera) & (tracks.t_in < end) & (tracks.t_out > begin))
        parts.append(_cut(part, np.maximum(part.t_in, begin), np.minimum(part.t_out, end)))
    return join(parts)


def broken(tracks: Sightings, mean_seconds: float, rng: np.random.Generator) -> Sightings:
    """Break tracks in two, on average once in ``mean_seconds`` of view."""
    stay = tracks.t_out - tracks.t_in
    split = rng.random(len(stay)) < 1 - np.exp(-stay / mean_seconds)
    begin = tracks.t_in + stay * rng.random(len(stay))
    end = np.where(
        split, np.minimum(begin + rng.uniform(*GAP_SECONDS, len(stay)), tracks.t_out), tracks.t_out
    )
    first = _cut(tracks, tracks.t_in, np.where(split, begin, tracks.t_out))
    return join([first, _cut(tracks, end, tracks.t_out).take(split)])


def _cut(tracks: Sightings, t_in: Floats, t_out: Floats) -> Sightings:
    """Return the part of passages from ``t_in`` to ``t_out``, as if people walked straight through.

    An end in mid-view has no zone.
    """
    stay = np.maximum(tracks.t_out - tracks.t_in, 1e-9)
    ahead = tracks.at_out - tracks.at_in
    at_in = tracks.at_in + ((t_in - tracks.t_in) / stay)[:, None] * ahead
    at_out = tracks.at_in + ((t_out - tracks.t_in) / stay)[:, None] * ahead
    zone_in = np.where(t_in > tracks.t_in, -1, tracks.zone_in)
    zone_out = np.where(t_out < tracks.t_out, -1, tracks.zone_out)
    return Sightings(tracks.person, tracks.camera, t_in, t_out, at_in, at_out, zone_in, zone_out)


def recorded(
    cameras: list[str],
    passages: Sightings,
    tracks: Sightings,
    faults: Faults,
    start: float,
    rng: np.random.Generator,
) -> tuple[list[Event], Truth]:
    """Return events sorted by time, and the ground truth.

        passages: true passages.
        tracks: passages as the trackers see them.
        start: event time at which the recording begins, seconds since the epoch.

    Missed and short passages and clutter are applied here.
    """
    # Drop short and missed passages, add clutter.
    tracks = tracks.take(tracks.t_out - tracks.t_in >= faults.short).sorted()
    number = _numbers(passages, tracks)
    is_detected = rng.random(len(number)) >= faults.missed
    tracks, number = tracks.take(is_detected), number[is_detected]
    ghosts = _ghosts(tracks, faults.clutter, rng)
    records = join([tracks, ghosts])
    number = np.concatenate([number, np.full(len(ghosts.person), CLUTTER)])

    # Events with noise, by time.
    n = len(number)
    at = np.concatenate([records.at_in, records.at_out])
    at = np.clip(at + faults.noise * rng.standard_normal(at.shape), 0.0, 1.0)
    t = np.concatenate([records.t_in, records.t_out])
    order = np.argsort(t, kind="stable")
    entry = np.arange(2 * n) < n
    events = events_of(
        cameras, np.tile(records.camera, 2), entry, t + start, at, np.tile(np.arange(n), 2), order
    )

    # Ground truth.
    zones = _zones(cameras, passages)
    truth = Truth(
        schema=TRUTH_SCHEMA,
        cameras=cameras,
        zones=zones,
        links=_links(zones, passages, tracks, number[: len(tracks.person)]),
        pairs=_pairs(cameras, passages.sorted()),
        identity=np.tile(records.person, 2)[order].tolist(),
        passage=np.tile(number, 2)[order].tolist(),
        zone=np.concatenate([records.zone_in, records.zone_out])[order].tolist(),
    )
    return events, truth


def _numbers(passages: Sightings, tracks: Sightings) -> Longs:
    """Return the number of each seen passage in its person's walk; unseen passages count, too."""
    records = join([passages, tracks])
    order = np.lexsort((records.camera, records.t_in, records.person))
    owner, camera, t_in = records.person[order], records.camera[order], records.t_in[order]
    is_new = np.zeros(len(owner), dtype=bool)
    is_new[1:] = (t_in[1:] != t_in[:-1]) | (camera[1:] != camera[:-1]) | (owner[1:] != owner[:-1])
    rank = np.cumsum(is_new)
    first_row = np.searchsorted(owner, owner)  # the row with which a person begins
    number = np.zeros(len(owner), dtype=np.int64)
    number[order] = rank - rank[first_row]
    return number[len(passages.person) :]


def _ghosts(tracks: Sightings, share: float, rng: np.random.Generator) -> Sightings:
    """Return clutter passages: cameras and times as busy as the real ones, random positions."""
    n = round(share / (1 - share) * len(tracks.person))
    like = tracks.take(rng.integers(0, max(len(tracks.person), 1), n))
    t_in = like.t_in + rng.uniform(-30.0, 30.0, n)
    t_in = np.clip(t_in, tracks.t_in.min(initial=0.0), tracks.t_in.max(initial=0.0))
    at_in = np.where(np.isnan(like.at_in), np.nan, rng.random((n, 2)))
    at_out = np.clip(at_in + GHOST_METRES_SD * rng.standard_normal((n, 2)), 0.0, 1.0)
    stay = GHOST_SECONDS * np.exp(GHOST_SECONDS_SD * rng.standard_normal(n))
    t_out = np.minimum(t_in + stay, tracks.t_out.max(initial=0.0))
    clutter = np.full(n, CLUTTER)
    return Sightings(clutter, like.camera, t_in, t_out, at_in, at_out, clutter, clutter)


def _pairs(cameras: list[str], passages: Sightings) -> list[Pair]:
    """Return overlapping pairs (people in both views at once) and unseen paths (in one, then the
    other).
    """
    together: dict[tuple[str, str], int] = {}
    after: dict[tuple[str, str], int] = {}
    shift = 1
    while (same_person := passages.person[shift:] == passages.person[:-shift]).any():
        moves = same_person & (passages.camera[shift:] != passages.camera[:-shift])
        at_once = moves & (passages.t_in[shift:] < passages.t_out[:-shift])
        for table, mask in (
            (together, at_once),
            (after, moves if shift == 1 else np.zeros_like(moves)),
        ):
            for a, b in zip(
                passages.camera[:-shift][mask], passages.camera[shift:][mask], strict=True
            ):
                low, high = sorted((cameras[a], cameras[b]))
                table[low, high] = table.get((low, high), 0) + 1
        shift += 1
    overlapping_pairs = {pair for pair, n in together.items() if n >= PAIR_WALKS_MIN}
    consecutive_pairs = {pair for pair, n in after.items() if n >= PAIR_WALKS_MIN}
    return [
        Pair(pair, "overlapped" if pair in overlapping_pairs else "unseen_path")
        for pair in sorted(overlapping_pairs | consecutive_pairs)
    ]


def _zones(cameras: list[str], passages: Sightings) -> list[TrueZone]:
    """Return one zone for each zone number in use, at the mean of its entries and exits."""
    zone = np.concatenate([passages.zone_in, passages.zone_out])
    camera, at = np.tile(passages.camera, 2), np.concatenate([passages.at_in, passages.at_out])
    result = []
    counts: dict[int, int] = {}
    for number in range(int(zone.max(initial=-1)) + 1):
        rows = np.flatnonzero(zone == number)
        owner = int(camera[rows[0]])
        counts[owner] = counts.get(owner, 0) + 1
        name = f"{cameras[owner]}/{counts[owner]}"
        if np.isnan(at[rows]).any():
            result.append(TrueZone(id=name, camera=cameras[owner]))
        else:
            result.append(zone_at(name, cameras[owner], at[rows]))
    return result


def _links(
    zones: list[TrueZone], passages: Sightings, tracks: Sightings, number: Longs
) -> list[TrueLink]:
    """Return the walked links; ``transitions`` counts those with both ends recorded."""
    if not zones:
        return []
    passages = passages.sorted()
    next_ = passages.person[1:] == passages.person[:-1]
    whole = (tracks.person[1:] == tracks.person[:-1]) & (number[1:] == number[:-1] + 1)
    whole &= (tracks.zone_out[:-1] >= 0) & (tracks.zone_in[1:] >= 0)
    ids = [zone.id for zone in zones]
    exits = np.bincount(passages.zone_out, minlength=len(zones)).tolist()
    lags: dict[tuple[str, str], list[float]] = {}
    columns = (
        passages.zone_out[:-1][next_],
        passages.zone_in[1:][next_],
        (passages.t_in[1:] - passages.t_out[:-1])[next_],
    )
    for u, v, lag in zip(*columns, strict=True):
        lags.setdefault((ids[u], ids[v]), []).append(float(lag))
    ends = zip(tracks.zone_out[:-1][whole], tracks.zone_in[1:][whole], strict=True)
    transitions = Counter((ids[u], ids[v]) for u, v in ends)
    return walked_links(lags, dict(zip(ids, exits, strict=True)), transitions)
