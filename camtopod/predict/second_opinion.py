"""The second opinion about an exit: paths between cameras (`camtopod.learn.paths`), as outcomes."""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats, Indices, Rows, ranges
from camtopod.columns import numbers
from camtopod.predict.outcomes import FLOOR, Table
from camtopod.records import PathColumns, Topology
from camtopod.topology import REACH_WIDTHS, LagBins, student_share

PATHS_WEIGHT_MAX = 0.5
"""Weight of the paths between cameras where no link of the zone is published."""


def with_paths(
    table: Table, topology: Topology, paths: PathColumns, bins: LagBins, exposure: Floats
) -> Table:
    """Return a table of outcomes that has the paths from the cameras as a second opinion.

    The more of the shares of a zone rests on published links, the less the paths count: links have
    been tested, paths have not.

    exposure (zones, bins): share of the departures of each zone that are exposed to each lag.
    """
    zones = topology.zones
    index = {zone.id: k for k, zone in enumerate(zones)}
    link_share = np.zeros(len(zones))
    for link in topology.links:
        if link.relation != "visible":
            link_share[index[link.from_]] += link.probability
    table_share = np.maximum(np.bincount(table.source, table.share, minlength=len(zones)), FLOOR)
    weight = PATHS_WEIGHT_MAX * np.maximum(1.0 - link_share / table_share, 0.0)

    # A path leads from all zones of its camera, and to all zones of its camera, as entries do.
    from_, to = (numbers(raw, np.int32, -1) for raw in (paths.from_, paths.to))
    share, place, width = (
        numbers(raw, np.float32, len(to)).astype(float)
        for raw in (paths.share, paths.place, paths.width)
    )
    end = np.arange(len(zones))
    if not paths.of_zones:
        camera = {site_camera.id: k for k, site_camera in enumerate(topology.cameras)}
        end = np.array([camera[zone.camera] for zone in zones], np.intp)
    path, source = _zones_at(end, from_)
    weighs = weight[source] > 0.0
    path, source = path[weighs], source[weighs]
    again, target = _zones_at(end, to[path])
    path, source = path[again], source[again]
    entries = np.array([zone.entries for zone in zones]) + 1e-9
    share = share[path] * (entries / np.bincount(end, entries)[end])[target]

    # Lags count from a delay on.
    delay = np.maximum(place - REACH_WIDTHS * width, 0.0)
    mass = np.diff(student_share(bins.edges, (place - delay)[:, None], width[:, None]), axis=1)
    past = int((bins.edges[1:] <= 0).sum())
    per_second = np.pad(mass / bins.widths, ((0, 0), (0, 1))).astype(np.float32)
    hazard = per_second[path] * share[:, None].astype(np.float32)
    hazard[:, :past] /= np.where((delay > 0.0)[path, None], 1.0, exposure[source, :past])
    seen_again = np.bincount(source, share, minlength=len(zones))
    row = np.argsort(np.append(table.source, source), kind="stable")
    zeros = np.zeros(len(path))
    return Table(
        source=np.append(table.source, source)[row],
        target=np.append(table.target, target)[row],
        share=np.append(table.share, share)[row],
        doubt=np.append(table.doubt, zeros)[row],
        delay=np.append(table.delay, delay[path])[row],
        hazard=np.concatenate((table.hazard, hazard))[row],
        by_path=row >= len(table.source),
        is_missed=np.append(table.is_missed, zeros > 0)[row],
        leave=table.leave,
        leave_by_paths=np.where(weight > 0.0, np.maximum(1.0 - seen_again, FLOOR), 0.0),
        paths_weight=weight,
    )


def _zones_at(end: Rows, ends: Indices) -> tuple[Rows, Rows]:
    """Return which of n ends each of m zones is at, and the zone, by n and then by zone.

    end (zones,): the end that each zone is at. ends (n,): ends.
    """
    order = np.argsort(end, kind="stable")
    sorted_end = end[order]
    first = sorted_end.searchsorted(ends)
    number, at = ranges(first, sorted_end.searchsorted(ends, "right") - first)
    return number, order[at]
