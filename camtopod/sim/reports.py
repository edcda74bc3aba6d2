"""Events that the cameras of a simulated network report, and the ground truth about them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Bools, Floats, Longs
from camtopod.records import Event, Transit
from camtopod.sim.faults import Setup, turned
from camtopod.sim.layout import Layout
from camtopod.sim.settings import SimSettings
from camtopod.sim.truth import (
    CLUTTER,
    TRUTH_SCHEMA,
    TrueLink,
    TrueZone,
    Truth,
    pairs_of,
    transit_of,
)
from camtopod.sim.walkers import Passages, jitter, seconds_per_metre


def report(
    passages: Passages, setup: Setup, settings: SimSettings, rng: np.random.Generator
) -> tuple[list[Event], Longs]:
    """Return events sorted by time, and their owners (events, 3): walker, number of the passage,
    zone.
    """
    layout = setup.layout
    n = len(passages.t_in)

    # Columns of entries, exits and clutter, in this order.
    extra = round(settings.clutter / (1 - settings.clutter) * 2 * n)
    zone = np.concatenate([passages.zone_in, passages.zone_out])
    camera = np.concatenate([layout.camera[zone], rng.integers(0, settings.cameras, extra)])
    t = np.concatenate(
        [passages.t_in, passages.t_out, rng.uniform(0, settings.hours * 3600.0, extra)]
    )
    entry = np.concatenate([np.ones(n, bool), np.zeros(n, bool), rng.random(extra) < 0.5])
    place = np.concatenate([_positions(layout, zone, settings, rng), rng.random((extra, 2))])
    track = np.concatenate([np.tile(np.arange(n), 2), n + np.arange(extra)])
    track[2 * n :][rng.random(extra) >= 0.5] = -1
    owner = np.full((2 * n + extra, 3), CLUTTER)
    owner[: 2 * n] = np.column_stack(
        [np.tile(passages.walker, 2), np.tile(passages.number, 2), zone]
    )

    # Lost and turned cameras, and clock offsets.
    inside = ~_lost(camera, t, layout, settings)
    for moved, (since, turn) in setup.turned.items():
        then = (camera == moved) & (t >= since)
        place[then] = turned(place[then], turn)
    t = np.round(t + setup.offsets[camera] + settings.start, 6)
    order = np.flatnonzero(inside)[np.argsort(t[inside], kind="stable")]

    # Leave out positions and tracks if asked to.
    if not settings.positions:
        place = np.full_like(place, np.nan)
    if not settings.tracks:
        track = np.full_like(track, -1)
    events = events_of(layout.cameras, camera, entry, t, place, track, order)
    return events, owner[order]


def _positions(
    layout: Layout, zone: Longs, settings: SimSettings, rng: np.random.Generator
) -> Floats:
    """Draw a position from each zone's normal distribution, clipped to the image."""
    spread = np.linalg.cholesky(layout.cov)
    at = layout.centre[zone] + np.einsum(
        "nij,nj->ni", spread[zone], rng.standard_normal((len(zone), 2))
    )
    rng.standard_normal(at.shape)  # unused, so that a seed keeps its events
    inside: Floats = np.clip(at, 0.0, 1.0)
    return inside


def _lost(camera: Longs, t: Floats, layout: Layout, settings: SimSettings) -> NDArray[np.bool_]:
    """Return which events fall into the outage of a camera."""
    gone = np.zeros(len(t), dtype=bool)
    for name, begin, end in settings.lost:
        gone |= (camera == layout.cameras.index(name)) & (t >= begin) & (t < end)
    return gone


def truth_of(setup: Setup, settings: SimSettings, recorded: Passages, owners: Longs) -> Truth:
    """Return the network at the end of the recording, and the object that caused each event."""
    layout = setup.layout
    first = np.r_[0, np.flatnonzero(np.diff(layout.camera)) + 1]
    number = np.arange(len(layout.camera)) - first[layout.camera] + 1
    ids = [f"{layout.cameras[c]}/{k}" for c, k in zip(layout.camera, number, strict=True)]
    zones = [_zone(setup, settings, zone, name) for zone, name in enumerate(ids)]
    links = _links(setup, settings, ids, recorded)
    return Truth(
        schema=TRUTH_SCHEMA,
        cameras=layout.cameras,
        zones=zones,
        links=links,
        pairs=pairs_of(links, {zone.id: zone.camera for zone in zones}),
        clock_offsets={
            c: round(float(o), 6) for c, o in zip(layout.cameras, setup.offsets, strict=True)
        },
        identity=owners[:, 0].tolist(),
        passage=owners[:, 1].tolist(),
        zone=owners[:, 2].tolist(),
    )


def _zone(setup: Setup, settings: SimSettings, zone: int, name: str) -> TrueZone:
    """Return a zone, with its former position if the camera was turned."""
    camera = int(setup.layout.camera[zone])
    if not settings.positions:
        return TrueZone(id=name, camera=setup.layout.cameras[camera])
    x, y = np.round(setup.layout.centre[zone], 4).tolist()
    cov = setup.layout.cov[zone]
    was = None
    moved_at = None
    if camera in setup.turned:
        since, turn = setup.turned[camera]
        was = (x, y)
        moved_at = settings.start + since
        x, y = np.round(turned(setup.layout.centre[zone], turn), 4).tolist()
        cov = turn @ cov @ turn.T
    cov = np.round(cov, 7).tolist()
    return TrueZone(
        id=name, camera=setup.layout.cameras[camera], x=x, y=y, cov=cov, moved_at=moved_at, was=was
    )


def _links(
    setup: Setup, settings: SimSettings, ids: list[str], recorded: Passages
) -> list[TrueLink]:
    """Return every path as a link: probability, transit times, and recorded transitions."""
    layout = setup.layout
    rng = np.random.default_rng((settings.seed, 3))
    walkers = 20_000  # from which the true transit times are computed
    forward = seconds_per_metre(settings, rng, walkers) * jitter(rng, walkers)
    metre = {True: transit_of(forward), False: transit_of(-forward)}
    walked = _walked(recorded)
    half_way = settings.start + settings.half_way
    links = []
    for inside, choices in ((True, layout.through), (False, layout.onward)):
        for u, k in np.argwhere(choices.probability > 0):
            v = int(choices.target[u, k])
            metres = float(choices.metres[u, k])
            way = int(u), v
            links.append(
                TrueLink(
                    from_=ids[u],
                    to=ids[v],
                    relation="visible" if inside else "unseen" if metres > 0 else "overlapped",
                    probability=round(float(choices.probability[u, k]), 6),
                    transitions=walked.get((inside, *way), 0),
                    transit=_times(metre[metres > 0], abs(metres)),
                    closed_at=half_way if not inside and way in setup.closing else None,
                    opened_at=half_way if not inside and way in setup.opening else None,
                )
            )
    return links


def _times(one: Transit, metres: float) -> Transit:
    """Scale the transit time of one metre to a path's length."""
    return Transit(
        *(
            round(time * metres, 4)
            for time in (one.mode, one.mean, one.sd, one.q10, one.q50, one.q90)
        )
    )


def _walked(recorded: Passages) -> dict[tuple[bool, int, int], int]:
    """Return (through a view?, from, to) -> number of walks with both ends recorded."""
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
    names = _track_names(camera, track, order)
    xy = np.round(at, 4)
    when = np.round(t, 6)
    placed = np.isfinite(at[:, 0])
    return [
        Event(
            camera=cameras[camera[i]],
            kind="entry" if entry[i] else "exit",
            t=float(when[i]),
            x=float(xy[i, 0]) if placed[i] else None,
            y=float(xy[i, 1]) if placed[i] else None,
            track=name,
        )
        for i, name in zip(order, names, strict=True)
    ]


def _track_names(camera: Longs, track: Longs, order: Longs) -> list[str | None]:
    """Number the tracks of each camera in the order they first appear, as a tracker would."""
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
