"""Basics of the camera network topology, shared by learning, prediction and the web page.

The records of a topology are in `camtopod.records`. Reading order: `lag_bins` (bins for transit
times), `histograms` (transit-time histograms as a version stores them), `grid` (image positions as
integers, and blocks of the image) and `shared_constants`. `camera_pairs` (overlapped views or
unseen paths) and `markov_chain` (the chain over cameras) are computed from links. `site_names` has
cameras' names within ids. `versions` has digests of versions
and the deltas between them. `first_links` says what a site without links waits for.
"""

from __future__ import annotations

from camtopod.topology.camera_pairs import find_camera_pairs, relation_of
from camtopod.topology.first_links import (
    joins_two_views,
    lacks_in_words,
    likely_links,
    links_between_views,
    links_in_words,
    waiting_for_links,
)
from camtopod.topology.grid import GRID_COLUMNS, GRID_ROWS, POSITION_ONE, block_of, blocks_of
from camtopod.topology.histograms import (
    DIGITS,
    STEPS,
    counts_histogram,
    masses_on_bins,
    round_significant,
    step_histogram,
)
from camtopod.topology.lag_bins import (
    LAG_SCALE_SECONDS,
    LAG_STEP,
    SMOOTHING_SD_BINS,
    LagBins,
    lag_smoothing_matrix,
    offset_bins,
    smooth,
)
from camtopod.topology.markov_chain import estimate_markov_chain
from camtopod.topology.shared_constants import (
    BACK_OFF_DEPARTURES,
    DWELL_SECONDS_MIN,
    LAG_SECONDS_MIN,
    LEAVE_FLOOR,
    MULTIPLIER_MAX,
    SLOWNESS_MAX,
    UNKNOWN_DWELL_SECONDS,
)
from camtopod.topology.site_names import (
    camera_of,
    mentions,
    renamed,
)
from camtopod.topology.versions import (
    ALARMS_KEPT_MAX,
    alarms_follow,
    apply_delta,
    link_key,
    make_delta,
    with_digest,
)

__all__ = [
    "ALARMS_KEPT_MAX",
    "BACK_OFF_DEPARTURES",
    "DIGITS",
    "DWELL_SECONDS_MIN",
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
    "STEPS",
    "UNKNOWN_DWELL_SECONDS",
    "LagBins",
    "alarms_follow",
    "apply_delta",
    "block_of",
    "blocks_of",
    "camera_of",
    "counts_histogram",
    "estimate_markov_chain",
    "find_camera_pairs",
    "joins_two_views",
    "lacks_in_words",
    "lag_smoothing_matrix",
    "likely_links",
    "link_key",
    "links_between_views",
    "links_in_words",
    "make_delta",
    "masses_on_bins",
    "mentions",
    "offset_bins",
    "relation_of",
    "renamed",
    "round_significant",
    "smooth",
    "step_histogram",
    "waiting_for_links",
    "with_digest",
]
