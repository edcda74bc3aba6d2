"""The topology's vocabulary, shared by learning, prediction, sharding and the web view.

Reading order: `lag_bins` (the time scale of transit times), `histograms` (transit-time histograms
as a version stores them), `grid` (image positions as integers), `shared_constants`, then what is
derived from links: `camera_pairs` (overlapped views or unseen paths) and `markov_chain` (the chain
over cameras). `versions` compares versions: keys, digests and deltas.
"""

from __future__ import annotations

from camtopod.topology.camera_pairs import camera_pairs, relation_of
from camtopod.topology.grid import GRID_COLUMNS, GRID_ROWS, POSITION_ONE, block_of, blocks_of
from camtopod.topology.histograms import (
    DIGITS,
    STEPS,
    counted,
    counts_added,
    in_steps,
    on_bins,
    scaled,
    short,
    steps_added,
)
from camtopod.topology.lag_bins import (
    LAG_SCALE_SECONDS,
    LAG_STEP,
    SMOOTHING_SD_BINS,
    LagBins,
    offset_bins,
    smooth,
    smoother,
)
from camtopod.topology.markov_chain import markov_chain
from camtopod.topology.shared_constants import (
    BACK_OFF_DEPARTURES,
    LAG_SECONDS_MIN,
    LEAVE_FLOOR,
    MULTIPLIER_MAX,
    SLOWNESS_MAX,
    STAY_SECONDS_MIN,
    UNKNOWN_STAY_SECONDS,
)
from camtopod.topology.versions import (
    ALARMS_KEPT_MAX,
    LinkKey,
    apply_delta,
    link_key,
    make_delta,
    stamp,
)

__all__ = [
    "ALARMS_KEPT_MAX",
    "BACK_OFF_DEPARTURES",
    "DIGITS",
    "GRID_COLUMNS",
    "GRID_ROWS",
    "LAG_SCALE_SECONDS",
    "LAG_SECONDS_MIN",
    "LAG_STEP",
    "LEAVE_FLOOR",
    "MULTIPLIER_MAX",
    "POSITION_ONE",
    "SLOWNESS_MAX",
    "SMOOTHING_SD_BINS",
    "STAY_SECONDS_MIN",
    "STEPS",
    "UNKNOWN_STAY_SECONDS",
    "LagBins",
    "LinkKey",
    "apply_delta",
    "block_of",
    "blocks_of",
    "camera_pairs",
    "counted",
    "counts_added",
    "in_steps",
    "link_key",
    "make_delta",
    "markov_chain",
    "offset_bins",
    "on_bins",
    "relation_of",
    "scaled",
    "short",
    "smooth",
    "smoother",
    "stamp",
    "steps_added",
]
