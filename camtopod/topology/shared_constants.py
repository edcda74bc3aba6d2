"""Limits that learning and prediction share, so that both treat a figure in the same way."""

LEAVE_FLOOR = 0.02
"""Smallest probability that an object which leaves a view leaves the site."""
STAY_DECILES = 11
"""Number of deciles of the dwell times of a zone, the shortest and the longest among them."""
UNKNOWN_DWELL_SECONDS = 10.0
"""Dwell time, in seconds, assumed for a view of unknown dwell times."""
DWELL_SECONDS_MIN = 0.2
"""Smallest dwell time in seconds; shorter ones count as this long."""
SLOWNESS_MAX = 1.5
"""Largest absolute slowness (natural log of a dwell time over the usual one).

Larger values come from loiterers and fragments of tracks.
"""
LAG_SECONDS_MIN = 2.0
"""Lag in seconds above which lags are taken to scale with an object's speed."""
BACK_OFF_DEPARTURES = 5.0
"""Weight, in departures, of a coarser context of a departure beside a finer one."""
MULTIPLIER_MAX = 100.0
"""Largest factor by which a context, or the speed of an object, raises a probability; the smallest
factor of a context is its inverse.
"""
