"""Entry and exit zones: where in a camera's view objects appear and disappear.

The view is a grid of 30 rows and 24 columns. For each cell, `cells` counts the events in the cell
and sums their positions; everything here is computed from these sums. Events of tracks that
begin or end anywhere in the view belong to no zone: they are *clutter*.

Reading order: `zone_map` turns the sums of a camera into numbered zones (`find_zones`). For that,
`partition` assigns the cells that have events to zones or to clutter. `partition` builds on

* `clutter`: the rate of clutter around each cell, and the first groups of cells;
* `daspec`: data spectroscopy, the clustering method of the thesis;
* `marginal_likelihood`: the evidence that a group of events is one zone;
* `separation`: the evidence that two groups of events are two zones;
* `ways`: the evidence that a group is a zone and no piece of a way between zones.

Last, `mixture` assigns every cell of the grid to one of the zones found, or to clutter.
"""

from camtopod.learn.zones.cells import (
    CELLS as CELLS,
    cell_sums as cell_sums,
    cells_of as cells_of,
)
from camtopod.learn.zones.clutter import CONTRAST_MIN as CONTRAST_MIN
from camtopod.learn.zones.daspec import BANDWIDTH_MIN as BANDWIDTH_MIN, kernel_1d as kernel_1d
from camtopod.learn.zones.mixture import ZoneShape as ZoneShape
from camtopod.learn.zones.zone_map import (
    ZoneMap as ZoneMap,
    find_zones as find_zones,
    refresh_zones as refresh_zones,
    same_places as same_places,
)
