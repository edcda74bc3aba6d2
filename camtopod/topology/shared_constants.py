"""Constants that learning and prediction share: both apply the same limits to the same figures."""

from __future__ import annotations

LEAVE_FLOOR = 0.02
"""Smallest probability that an object which leaves a view is not seen again."""
UNKNOWN_STAY_SECONDS = 10.0
"""Duration of a passage through a view where none has been observed, seconds."""
STAY_SECONDS_MIN = 0.2
"""Shorter passages count as this long, seconds."""
SLOWNESS_MAX = 1.5
"""Largest absolute log slowness; passages slower or faster than this are loiterers and fragments of
tracks.
"""
LAG_SECONDS_MIN = 2.0
"""Shorter lags, seconds, do not scale with an object's speed."""
BACK_OFF_DEPARTURES = 5.0
"""Departures of a coarser context that weigh as much as those of a finer one."""
MULTIPLIER_MAX = 100.0
"""Largest factor by which a context raises or lowers a hazard."""
