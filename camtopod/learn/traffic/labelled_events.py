"""Label the window's events with zones; the result is a `Scene`, the input of the fits.

`label_events` finds the zone of each event from the zone map of its camera, and sorts events into
departures (exits) and arrivals (entries). A passage, an entry and an exit of one track, is a
departure whose arrival is known (`Departures.own`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Indices, Ints
from camtopod.event_time import MICROSECONDS
from camtopod.learn.traffic.background_rate import local_rates
from camtopod.learn.traffic.events import Arrivals, Departures
from camtopod.learn.traffic.labels import label_shares
from camtopod.learn.traffic.rhythm import rhythm_rates
from camtopod.learn.traffic.speed import slowness
from camtopod.learn.window import Window
from camtopod.learn.zones import ZoneMap, ZoneShape, cells_of
from camtopod.topology import blocks_of


class ZoneRef(NamedTuple):
    """A zone of the site.

    camera: index of its camera.
    number: its number among the zones of that camera.
    shape: mean and covariance; None for the single zone of a camera whose events have no positions.
    """

    camera: int
    number: int
    shape: ZoneShape | None


class Scene(NamedTuple):
    """The labelled events of the window, the input of the fits."""

    zones: list[ZoneRef]
    """The zones of all cameras; a zone's index in this list is its number in all tables."""
    departures: Departures
    arrivals: Arrivals
    entries: NDArray[np.int64]
    """(zones,) number of entries at each zone."""
    exits: NDArray[np.int64]
    """(zones,) number of exits at each zone."""
    is_tracked: NDArray[np.bool_]
    """(cameras,) True for cameras whose tracks tie most exits to an entry."""
    first: float
    """Time of the first event in seconds."""
    last: float
    """Time in seconds up to which the events of all cameras are known."""
    labels: Sequence[str] = ()
    """The labels that count, by number."""


def number_zones(window: Window, maps: list[ZoneMap]) -> tuple[list[ZoneRef], NDArray[np.int32]]:
    """Number the zones of all cameras.

    maps: zone map of each camera.

    Return the zones, and a table (cameras, cells + 1) with the index of the zone of each grid cell,
    -1 for clutter. The last column is for events without position: they belong to the single
    zone of a camera none of whose events has a position, and otherwise to no zone.
    """
    unplaced_cameras = set(window.column("camera")[~window.has_position()].tolist())
    zones: list[ZoneRef] = []
    tables = []
    for camera, zone_map in enumerate(maps):
        first = len(zones)
        zones.extend(ZoneRef(camera, shape.number, shape) for shape in zone_map.zones)
        cells = zone_map.cells.ravel().astype(np.int32)
        table = np.append(np.where(cells >= 0, cells + first, -1), -1)

        # A camera whose events have no positions is one zone.
        if not zone_map.zones and camera in unplaced_cameras:
            table[-1] = len(zones)
            zones.append(ZoneRef(camera, 1, None))
        tables.append(table)
    return zones, np.array(tables, np.int32)


def label_events(window: Window, maps: list[ZoneMap], ahead: Floats | None = None) -> Scene:
    """Label the events of a window that is not empty: departures and arrivals.

    maps: zone map of each camera.
    ahead (cameras, seconds): clock offsets to be subtracted from the times; None for none.
    """
    # Times, corrected for the offsets of the clocks.
    zones, tables = number_zones(window, maps)
    camera = window.column("camera").astype(np.int32)
    t = window.column("t") / MICROSECONDS
    last = float(t[-1])
    if ahead is not None:
        t = t - ahead[camera]
        # The events of a camera with a fast clock are known only up to this corrected time.
        last -= max(float(ahead.max(initial=0.0)), 0.0)

    # The zone of each event, and the row of the entry of each exit.
    entry = window.column("entry")
    px, py = (window.column(name).astype(np.int64) for name in ("px", "py"))
    zone = tables[camera, cells_of(px, py)]
    mate = window.entries_of_exits()
    n = len(zones)

    # Rows of departures and arrivals, by corrected time.
    by_time = np.argsort(t, kind="stable")
    by_time = by_time[zone[by_time] >= 0]
    exit_rows = by_time[~entry[by_time]]
    entry_rows = by_time[entry[by_time]]

    # Passages with both ends in a zone have a slowness, which their entry and exit get.
    entry_of_exit = mate[exit_rows]
    since = np.where(entry_of_exit >= 0, t[np.maximum(entry_of_exit, 0)], -np.inf)
    tied_rows = exit_rows[entry_of_exit >= 0]
    tied_rows = tied_rows[zone[mate[tied_rows]] >= 0]
    tied_entries = mate[tied_rows]
    slow = np.full(len(t), np.nan)
    slow[tied_rows] = slow[tied_entries] = slowness(
        zone[tied_entries], zone[tied_rows], t[tied_rows] - t[tied_entries], n
    )

    # Departures, with the row of the arrival that began their passage.
    arrival = np.full(len(t) + 1, -1, np.int32)
    arrival[entry_rows] = np.arange(len(entry_rows), dtype=np.int32)
    own_arrival = arrival[np.where(entry_of_exit >= 0, entry_of_exit, len(t))]
    block = blocks_of(px[exit_rows], py[exit_rows])
    departures = Departures(
        t[exit_rows], zone[exit_rows], camera[exit_rows], since, slow[exit_rows], own_arrival, block
    )
    arrivals = _arrivals(t[entry_rows], zone[entry_rows], camera[entry_rows], slow[entry_rows], n)
    labels, label = window.labels()
    if len(labels) > 1:
        share = label_shares(arrivals.zone, label[entry_rows], n)
        departures = departures._replace(label=label[exit_rows])
        arrivals = arrivals._replace(label=label[entry_rows], label_share=share)

    return Scene(
        zones,
        departures,
        arrivals,
        np.bincount(zone[entry_rows], minlength=n),
        np.bincount(zone[exit_rows], minlength=n),
        _tracked(camera[~entry], mate[~entry], len(window.cameras)),
        float(t.min()),
        last,
        labels,
    )


def _arrivals(t: Floats, zone: Ints, camera: Ints, slow: Floats, zones: int) -> Arrivals:
    """Return arrivals without labels, with the local rates of arrivals that their rhythm makes.

    t, zone, camera, slow (m,): columns of `Arrivals`; zones: number of zones.
    """
    even = local_rates(t, zone, zones)
    rate = rhythm_rates(t, zone, even, zones)
    return Arrivals(t, zone, camera, rate, slow, even / rate)


def _tracked(camera: Ints, mate: Indices, cameras: int) -> NDArray[np.bool_]:
    """Return a mask (cameras,) of those at which tracks tie most exits to an entry.

    camera, mate (n,): camera of each exit, and row of its entry, -1 if unknown.
    """
    untied_count = np.bincount(camera, np.where(mate >= 0, -1.0, 1.0), cameras)
    return untied_count < 0
