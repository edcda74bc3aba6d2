"""The scene: the window's events labelled with zones, as departures, arrivals and passages."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Ints
from camtopod.event_time import MICROSECONDS
from camtopod.learn.traffic.background_rate import local_rates
from camtopod.learn.traffic.events import Arrivals, Departures
from camtopod.learn.traffic.speed import slowness
from camtopod.learn.window import Window, cells_of
from camtopod.learn.zones import ZoneMap, ZoneShape
from camtopod.topology import blocks_of

NO_ZONE = -1
"""In place of a zone's index for events that belong to none (clutter)."""


class ZoneRef(NamedTuple):
    """A zone of the network: index of its camera, its number there, and its shape.

    shape: None for the single zone of a camera whose events have no positions.
    """

    camera: int
    number: int
    shape: ZoneShape | None


class Passages(NamedTuple):
    """Passages known from tracks; each column has shape (n,).

    source, target: zones of the entry and of the exit.
    entered, left: times of the entry and of the exit in seconds.
    """

    source: Ints
    target: Ints
    entered: Floats
    left: Floats


class Scene(NamedTuple):
    """The labelled events of the window, the input of the fits."""

    zones: list[ZoneRef]
    departures: Departures
    arrivals: Arrivals
    passages: Passages
    entries: NDArray[np.int64]
    """Entries at each zone, (zones,)."""
    exits: NDArray[np.int64]
    """Exits at each zone, (zones,)."""
    tracked: NDArray[np.bool_]
    """True for cameras of which most exits have the entry of their track, (cameras,)."""
    first: float
    """Time of the first event in seconds."""
    last: float
    """Time in seconds up to which the events of all cameras are known."""


def number_zones(window: Window, maps: list[ZoneMap]) -> tuple[list[ZoneRef], NDArray[np.int32]]:
    """Number the zones of the network.

    Return the zones, and a table (cameras, cells + 1) with the index of the zone of each cell. The
    last column is for events without position; such events have a zone only at cameras without any
    other zone.
    """
    zones: list[ZoneRef] = []
    tables = []
    for camera, zone_map in enumerate(maps):
        first = len(zones)
        zones.extend(ZoneRef(camera, shape.number, shape) for shape in zone_map.zones)
        cells = zone_map.cells.ravel().astype(np.int32)
        table = np.append(np.where(cells >= 0, cells + first, NO_ZONE), NO_ZONE)

        # A camera whose events have no positions is one zone.
        if not zone_map.zones and window.unplaced[camera].sum() > 0:
            table[-1] = len(zones)
            zones.append(ZoneRef(camera, 1, None))
        tables.append(table)
    size = len(tables[0]) if tables else 1
    return zones, np.stack(tables).astype(np.int32) if tables else np.zeros((0, size), np.int32)


def label_events(window: Window, maps: list[ZoneMap], ahead: Floats | None = None) -> Scene:
    """Label the window's events with zones, and sort them into departures, arrivals and passages.

    ahead (cameras, seconds): clock offset of each camera (positive if fast), by which times are
        corrected; None to use the cameras' own times.
    """
    # Times, corrected for the offsets of the clocks.
    zones, tables = number_zones(window, maps)
    camera = window.column("camera").astype(np.int32)
    t = window.column("t") / MICROSECONDS
    last = float(t[-1]) if len(t) else 0.0
    if ahead is not None:
        t = t - ahead[camera]
        # The events of a camera with a fast clock are known only up to this corrected time.
        last -= max(float(ahead.max(initial=0.0)), 0.0)

    # The zone of each event, and the row of the entry of each exit.
    entry = window.column("entry").astype(bool)
    zone = tables[
        camera, cells_of(window.column("px").astype(np.int64), window.column("py").astype(np.int64))
    ]
    mate = window.column("mate").astype(np.int64) - window.base
    n = len(zones)

    # Rows of departures and arrivals, by corrected time.
    leaves = np.flatnonzero(~entry & (zone >= 0))
    comes = np.flatnonzero(entry & (zone >= 0))
    leaves, comes = (rows[np.argsort(t[rows], kind="stable")] for rows in (leaves, comes))

    # Passages: those with both ends in a zone have a slowness, which both ends get.
    began = mate[leaves]
    since = np.where(began >= 0, t[np.maximum(began, 0)], -np.inf)
    known = leaves[began >= 0]
    known = known[zone[mate[known]] >= 0]
    start = mate[known]
    slow = np.full(len(t), np.nan)
    slow[known] = slow[start] = slowness(zone[start], zone[known], t[known] - t[start], n)

    # Departures, with the arrival that began their passage.
    arrival = np.full(len(t) + 1, -1, np.int32)
    arrival[comes] = np.arange(len(comes), dtype=np.int32)
    own = arrival[np.where(began >= 0, began, len(t))]
    block = blocks_of(window.column("px")[leaves], window.column("py")[leaves])
    departures = Departures(
        t[leaves], zone[leaves], camera[leaves], since, slow[leaves], own, block
    )

    # Arrivals and passages.
    rate = local_rates(t[comes], zone[comes], n)
    arrivals = Arrivals(t[comes], zone[comes], camera[comes], rate, slow[comes])
    passages = Passages(zone[start], zone[known], t[start], t[known])

    # Share of exits with an entry, by camera.
    cameras = len(window.cameras)
    exits_of = np.bincount(camera[~entry], minlength=cameras)
    tied_of = np.bincount(camera[~entry & (mate >= 0)], minlength=cameras)
    return Scene(
        zones,
        departures,
        arrivals,
        passages,
        np.bincount(zone[comes], minlength=n),
        np.bincount(zone[leaves], minlength=n),
        2 * tied_of > exits_of,
        float(t.min()) if len(t) else 0.0,
        last,
    )
