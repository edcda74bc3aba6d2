"""Basics of the camera network topology, shared by learning, prediction and the web page.

The records of a topology are in `camtopod.records`. Reading order: `lag_bins` (bins for transit
times), `histograms` (transit-time histograms as a version stores them), `grid` (image positions as
integers, and blocks of the image), `student_t` (lags of a path) and `shared_constants`.
`declared_pairs` has what a user has declared. `camera_pairs` (overlapped views or unseen paths) are
computed from links. `site_names` has cameras' names
within ids. `versions` has digests of versions and the deltas between them. `named_figures`
has weak links and what else a model says by name, and `first_links` says what a site without links
waits for. `places` finds cameras and zones by name.
"""

from camtopod.topology.camera_pairs import (
    RELATIONS as RELATIONS,
    find_camera_pairs as find_camera_pairs,
    relation_of as relation_of,
)
from camtopod.topology.declared_pairs import (
    declared_odds as declared_odds,
    favours as favours,
)
from camtopod.topology.first_links import (
    evidence_for_links as evidence_for_links,
    lacks_in_words as lacks_in_words,
    likely_links as likely_links,
    links_between_views as links_between_views,
    longest_lag as longest_lag,
    range_in_words as range_in_words,
    waiting_for_links as waiting_for_links,
)
from camtopod.topology.grid import (
    GRID_COLUMNS as GRID_COLUMNS,
    GRID_ROWS as GRID_ROWS,
    POSITION_ONE as POSITION_ONE,
    block_of as block_of,
    blocks_of as blocks_of,
)
from camtopod.topology.histograms import (
    STEPS as STEPS,
    counts_histogram as counts_histogram,
    masses_of as masses_of,
    masses_on_bins as masses_on_bins,
    round_significant as round_significant,
    step_histograms as step_histograms,
)
from camtopod.topology.lag_bins import (
    DWELL_SECONDS_MAX as DWELL_SECONDS_MAX,
    LAG_SCALE_SECONDS as LAG_SCALE_SECONDS,
    LAG_STEP as LAG_STEP,
    SMOOTHING_SD_BINS as SMOOTHING_SD_BINS,
    LagBins as LagBins,
    dwell_bins as dwell_bins,
    lag_smoothing_matrix as lag_smoothing_matrix,
    offset_bins as offset_bins,
    smooth as smooth,
)
from camtopod.topology.named_figures import (
    by_name as by_name,
    last_events as last_events,
    weak_columns as weak_columns,
    weak_links as weak_links,
)
from camtopod.topology.places import (
    UnknownPlace as UnknownPlace,
    zone_at as zone_at,
    zones_of as zones_of,
)
from camtopod.topology.shared_constants import (
    BACK_OFF_DEPARTURES as BACK_OFF_DEPARTURES,
    DWELL_SECONDS_MIN as DWELL_SECONDS_MIN,
    LAG_SECONDS_MIN as LAG_SECONDS_MIN,
    LEAVE_FLOOR as LEAVE_FLOOR,
    MULTIPLIER_MAX as MULTIPLIER_MAX,
    SLOWNESS_MAX as SLOWNESS_MAX,
    STAY_DECILES as STAY_DECILES,
    UNKNOWN_DWELL_SECONDS as UNKNOWN_DWELL_SECONDS,
)
from camtopod.topology.site_names import (
    camera_of as camera_of,
    mentions as mentions,
    renamed as renamed,
)
from camtopod.topology.student_t import (
    DEGREES as DEGREES,
    REACH_WIDTHS as REACH_WIDTHS,
    student_density as student_density,
    student_share as student_share,
)
from camtopod.topology.versions import (
    ALARMS_KEPT_MAX as ALARMS_KEPT_MAX,
    alarms_follow as alarms_follow,
    link_key as link_key,
    make_delta as make_delta,
    map_of as map_of,
    version_model as version_model,
    with_digest as with_digest,
)
