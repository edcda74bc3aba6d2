"""Clock offsets of the cameras, estimated from traffic alone.

A camera's *clock offset* is by how many seconds its clock is fast. Reading order: `correlogram`
counts arrivals of one zone or camera by their lag after departures from another; `two_way_paths`
finds paths that objects take in both directions, each of which shows the difference of two clocks;
`offsets` combines the differences into one offset per camera.
"""

from camtopod.learn.clocks.correlogram import (
    LAGS as LAGS,
    ROWS_AT_ONCE as ROWS_AT_ONCE,
    Correlograms as Correlograms,
    Counts as Counts,
    cache_friendly_order as cache_friendly_order,
    null_expectation as null_expectation,
)
from camtopod.learn.clocks.offsets import (
    CLEAR_SD as CLEAR_SD,
    Clocks as Clocks,
    ClockState as ClockState,
)
