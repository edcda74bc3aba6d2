"""Events that the cameras of a simulated network report, and the ground truth about them."""

from __future__ import annotations

from collections import Counter

import numpy as np

from camtopod.arrays import Bools, Floats, Longs
from camtopod.records import Event, Transit
from camtopod.sim.layout import Layout
from camtopod.sim.settings import SimSettings
from camtopod.sim.truth import (
    CLUTTER,
    TRUTH_SCHEMA,
    TrueLink,
    TrueZone,
    Truth,
    pairs_of,
    relation_of,
    transit_of,
)
from camtopod.sim.walkers import Passages, jitter, seconds_per_metre


def report(
    passages: Passages, layout: Layout, settings: SimSettings, rng: np.random.Generator
) -> tuple[list[Event], Longs]:
    """Return events sorted by time, and their owners (events, 3): walker, number of the passage,
    zone.
    """
    n = len(passages.t_in)

    # Columns of entries, exits and clutter, in this order.
    extra = round(settings.clutter / (1 - settings.clutter) * 2 * n)
    zone = np.concatenate([passages.zone_in, passages.zone_out])
    camera = np.concatenate([layout.camera[zone], rng.integers(0, settings.cameras, extra)])
    t = np.concatenate(
        [passages.t_in, passages.t_out, rng.uniform(0, settings.hours * 3600.0, extra)]
    )
    entry = np.concatenate([np.ones(n, bool), np.zeros(n, bool), rng.random(extra) < 0.5])
    spread = np.linalg.cholesky(layout.cov)[zone]
    at = layout.centre[zone] + np.einsum("nij,nj->ni", spread, rng.standard_normal((2 * n, 2)))
    rng.standard_normal(at.shape)  # unused, so that a seed keeps its events
    place = np.concatenate([np.clip(at, 0.0, 1.0), rng.random((extra, 2))])
    track = np.concatenate([np.tile(np.arange(n), 2), n + np.arange(extra)])
    track[2 * n :][rng.random(extra) >= 0.5] = -1
    owner = np.full((2 * n + extra, 3), CLUTTER)
    owner[: 2 * n] = np.column_stack(
        [np.tile(passages.walker, 2), np.tile(passages.number, 2), zone]
    )

    # Events by time.
    t = np.round(t + settings.start, 6)
    order = np.argsort(t, kind="stable")
    return events_of(layout.cameras, camera, entry, t, place, track, order), owner[order]


def truth_of(
    layout: Layout, settings: SimSettings, recorded_passages: Passages, owners: Longs
) -> Truth:
    """Return the network at the end of the recording, and the object that caused each event."""
    first = np.r_[0, np.flatnonzero(np.diff(layout.camera)) + 1]
    number = np.arange(len(layout.camera)) - first[layout.camera] + 1
    cameras = [layout.cameras[c] for c in layout.camera]
    centres = np.round(layout.centre, 4).tolist()
    covs = np.round(layout.cov, 7).tolist()
    zones = [
        TrueZone(f"{camera}/{k}", camera, x, y, cov)
        for camera, k, (x, y), cov in zip(cameras, number, centres, covs, strict=True)
    ]
    links = _links(layout, settings, [zone.id for zone in zones], recorded_passages)
    return Truth(
        schema=TRUTH_SCHEMA,
        cameras=layout.cameras,
        zones=zones,
        links=links,
        pairs=pairs_of(links, {zone.id: zone.camera for zone in zones}),
        clock_offsets=dict.fromkeys(layout.cameras, 0.0),
        identity=owners[:, 0].tolist(),
        passage=owners[:, 1].tolist(),
        zone=owners[:, 2].tolist(),
    )


def _links(
    layout: Layout, settings: SimSettings, ids: list[str], recorded_passages: Passages
) -> list[TrueLink]:
    """Return every path as a link: probability, transit times, and recorded transitions."""
    rng = np.random.default_rng((settings.seed, 3))
    walkers = 20_000  # from which the true transit times are computed
    forward = seconds_per_metre(settings, rng, walkers) * jitter(rng, walkers)
    metre = {True: transit_of(forward), False: transit_of(-forward)}
    walk_counts = _walked(recorded_passages)
    half_way = settings.start + settings.half_way
    closed_at = dict.fromkeys(layout.closing, half_way)
    opened_at = dict.fromkeys(layout.opening, half_way)
    links = []
    for inside, choices in ((True, layout.through), (False, layout.onward)):
        for u, k in np.argwhere(choices.probability > 0):
            metres = float(choices.metres[u, k])
            way = int(u), int(choices.target[u, k])
            links.append(
                TrueLink(
                    from_=ids[way[0]],
                    to=ids[way[1]],
                    relation="visible" if inside else relation_of(metres),
                    probability=round(float(choices.probability[u, k]), 6),
                    transitions=walk_counts.get((inside, *way), 0),
                    transit=_times(metre[metres > 0], abs(metres)),
                    closed_at=closed_at.get(way),
                    opened_at=opened_at.get(way),
                )
            )
    return links


def _times(transit: Transit, metres: float) -> Transit:
    """Scale the transit time of one metre to a path's length."""
    return Transit(
        *(
            round(time * metres, 4)
            for time in (
                transit.mode,
                transit.mean,
                transit.sd,
                transit.q10,
                transit.q50,
                transit.q90,
            )
        )
    )


def _walked(recorded_passages: Passages) -> dict[tuple[bool, int, int], int]:
    """Return (through a view?, from, to) -> number of walks with both ends recorded."""
    p = recorded_passages.take(np.lexsort((recorded_passages.number, recorded_passages.walker)))
    next_ = (p.walker[1:] == p.walker[:-1]) & (p.number[1:] == p.number[:-1] + 1)
    result: dict[tuple[bool, int, int], int] = {}
    for inside, u, v in (
        (True, p.zone_in, p.zone_out),
        (False, p.zone_out[:-1][next_], p.zone_in[1:][next_]),
    ):
        ways, counts = np.unique(np.column_stack([u, v]), axis=0, return_counts=True)
        result |= {(inside, int(a), int(b)): int(n) for (a, b), n in zip(ways, counts, strict=True)}
    return result


def events_of(
    cameras: list[str],
    camera: Longs,
    entry: Bools,
    t: Floats,
    at: Floats,
    track: Longs,
    order: Longs,
) -> list[Event]:
    """Return events from columns, in ``order``.

    camera, entry, t (n,): camera index, True for an entry, event time.
    at (n, 2): position in the image, or nan.
    track (n,): track number, or -1.
    """
    kinds = np.where(entry, "entry", "exit")[order].tolist()
    times = np.round(t, 6)[order].tolist()
    places = np.where(np.isfinite(at), np.round(at, 4), None)[order].tolist()  # type: ignore[call-overload]
    names = [cameras[k] for k in camera[order]]
    tracks = _track_names(names, track[order].tolist())
    return [
        Event(name, kind, t, x, y, number)
        for name, kind, t, (x, y), number in zip(names, kinds, times, places, tracks, strict=True)
    ]


def _track_names(cameras: list[str], tracks: list[int]) -> list[str | None]:
    """Number the tracks of each camera in the order they first appear, as a tracker would."""
    names: dict[int, str | None] = {-1: None}
    counts: Counter[str] = Counter()
    for camera, track in zip(cameras, tracks, strict=True):
        if track not in names:
            counts[camera] += 1
            names[track] = str(counts[camera])
    return [names[track] for track in tracks]
