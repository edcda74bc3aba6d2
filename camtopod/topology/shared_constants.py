"""Limits that learning and prediction share, so that both treat the same figures alike."""

from __future__ import annotations

LEAVE_FLOOR = 0.02
"""Smallest probability that an object which leaves a view is not seen again."""
UNKNOWN_DWELL_SECONDS = 10.0
"""Dwell time assumed for a view where none has been observed, seconds."""
DWELL_SECONDS_MIN = 0.2
"""Smallest dwell time, seconds; shorter ones count as this."""
SLOWNESS_MAX = 1.5
"""Largest absolute slowness (natural log); beyond are loiterers and fragments of tracks."""
LAG_SECONDS_MIN = 2.0
"""Largest lag, in seconds, that is taken not to scale with an object's speed."""
BACK_OFF_DEPARTURES = 5.0
"""Weight of a coarser context beside a finer one, in departures."""
MULTIPLIER_MAX = 100.0
"""Largest factor by which a context raises a hazard; its inverse is the smallest."""
