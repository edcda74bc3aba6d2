"""Entry and exit zones: where in a camera's view objects appear and disappear.

Reading order: `zone_map` turns sums over a camera's grid cells into numbered zones, by way of
`partition`, which assigns the cells to zones. `partition` builds on

* `clutter`: the rate of events that belong to no zone, and the first groups of cells;
* `daspec`: data spectroscopy, the clustering method of the thesis;
* `marginal_likelihood`: the evidence that a group of events is one zone;
* `separation`: the evidence that two groups are separated by a gap or a valley.

`mixture` labels every cell of the grid once the zones are known. `cell_sums` stores the sums.
"""

from __future__ import annotations

from camtopod.learn.zones.cell_sums import GridSums
from camtopod.learn.zones.daspec import kernel_1d
from camtopod.learn.zones.zone_map import (
    MATCH_DISTANCE,
    PLACE_SD_MIN,
    CellSums,
    ZoneMap,
    ZoneShape,
    find_zones,
    refresh_zones,
)

__all__ = [
    "MATCH_DISTANCE",
    "PLACE_SD_MIN",
    "CellSums",
    "GridSums",
    "ZoneMap",
    "ZoneShape",
    "find_zones",
    "kernel_1d",
    "refresh_zones",
]
