"""zones"""

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
