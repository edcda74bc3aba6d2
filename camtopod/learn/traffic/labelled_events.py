"""The window seen through the zones: which event belongs to which zone, who left, who came, who
passed through.
"""

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


class ZoneRef(NamedTuple):
    """A zone of the whole network: its camera's index, its number there, and its shape (None: no
    positions).
    """

    camera: int
    number: int
    shape: ZoneShape | None


class Passages(NamedTuple):
    """Passages through one camera's view known by their track: zones of entry and exit, times in
    seconds.
    """

    source: Ints
    target: Ints
    entered: Floats
    left: Floats


class Scene(NamedTuple):
    """What the fit works on."""

    zones: list[ZoneRef]
    departures: Departures
    arrivals: Arrivals
    passages: Passages
    entries: NDArray[np.int64]
    """(zones,) events in the window."""
    exits: NDArray[np.int64]
    tracked: NDArray[np.bool_]
    """(cameras,) whether most exits of the camera are tied to an entry by their track."""
    first: float
    last: float


def number_zones(window: Window, maps: list[ZoneMap]) -> tuple[list[ZoneRef], NDArray[np.int32]]:
    """All zones of the network, and per camera and cell the zone's index: (cameras, cells + 1), the
    last for no position.
    """
    zones: list[ZoneRef] = []
    tables = []
    for camera, zone_map in enumerate(maps):
        first = len(zones)
        zones.extend(ZoneRef(camera, shape.number, shape) for shape in zone_map.zones)
        cells = zone_map.cells.ravel().astype(np.int32)
        table = np.append(np.where(cells >= 0, cells + first, NO_ZONE), NO_ZONE)
        if not zone_map.zones and window.unplaced[camera].sum() > 0:
            table[-1] = len(zones)
            zones.append(ZoneRef(camera, 1, None))
        tables.append(table)
    size = len(tables[0]) if tables else 1
    return zones, np.stack(tables).astype(np.int32) if tables else np.zeros((0, size), np.int32)


def see(window: Window, maps: list[ZoneMap], ahead: Floats | None = None) -> Scene:
    """Label the window's events with zones and sort them into departures, arrivals and passages.

    ``ahead`` (cameras,): by how many seconds each camera's clock is; None: by their own clocks.
    """
    zones, tables = number_zones(window, maps)
    camera = window.column("camera").astype(np.int32)
    t = window.column("t") / MICROSECONDS
    last = float(t[-1]) if len(t) else 0.0
    if ahead is not None:
        t = t - ahead[camera]
        last -= max(float(ahead.max(initial=0.0)), 0.0)  # up to here all cameras have been heard
    entry = window.column("entry").astype(bool)
    zone = tables[
        camera, cells_of(window.column("px").astype(np.int64), window.column("py").astype(np.int64))
    ]
    mate = window.column("mate").astype(np.int64) - window.base
    n = len(zones)
    leaves = np.flatnonzero(~entry & (zone >= 0))
    comes = np.flatnonzero(entry & (zone >= 0))
    leaves, comes = (rows[np.argsort(t[rows], kind="stable")] for rows in (leaves, comes))
    began = mate[leaves]
    since = np.where(began >= 0, t[np.maximum(began, 0)], -np.inf)
    known = leaves[began >= 0]
    known = known[zone[mate[known]] >= 0]
    start = mate[known]
    slow = np.full(len(t), np.nan)
    slow[known] = slow[start] = slowness(zone[start], zone[known], t[known] - t[start], n)
    arrival = np.full(len(t) + 1, -1, np.int32)
    arrival[comes] = np.arange(len(comes), dtype=np.int32)
    own = arrival[np.where(began >= 0, began, len(t))]
    block = blocks_of(window.column("px")[leaves], window.column("py")[leaves])
    departures = Departures(
        t[leaves], zone[leaves], camera[leaves], since, slow[leaves], own, block
    )
    rate = local_rates(t[comes], zone[comes], n)
    arrivals = Arrivals(t[comes], zone[comes], camera[comes], rate, slow[comes])
    passages = Passages(zone[start], zone[known], t[start], t[known])
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
