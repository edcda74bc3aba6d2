"""The association problem: departures and arrivals of a window, some of which are of one object.

`exposures` counts how many departures could have been seen to arrive after each lag.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camtopod.arrays import Floats, Ints, rows_by_group
from camtopod.learn.traffic import Arrivals, Departures
from camtopod.topology import LagBins


class LagRanges(NamedTuple):
    """R ranges of lags: one of each zone of departure, and one of each that begins a long path."""

    zone: Ints
    """(R,) zone of departure; range z is that of zone z without a delay."""
    delay: Floats
    """(R,) seconds from the departure to lag 0 of the bins: 0, or those of a long path
    (`camtopod.learn.long_paths`).
    """
    of: Ints
    """(zones, zones) range of the lags from each zone to each."""


class Problem(NamedTuple):
    """Departures and arrivals, of which the fits estimate which are of one object."""

    departures: Departures
    arrivals: Arrivals
    bins: LagBins
    """Bins of the lags from a departure, or its delayed time, to an arrival."""
    zones: int
    """Number of zones; zones of departure and arrival are numbered from 0."""
    until: float
    """End of the window, seconds: later arrivals could not be seen."""
    ranges: LagRanges | None = None
    """Ranges of lags; None without long paths, where range z is that of zone z."""
    odds: Floats | None = None
    """(cameras, cameras) odds of a path by what was declared (`camtopod.topology.declared_odds`);
    None for 1.
    """

    def cameras(self) -> Ints:
        """Return the camera of each zone, (zones,); 0 for a zone without any event."""
        camera = np.zeros(self.zones, np.int32)
        camera[self.departures.zone] = self.departures.camera
        camera[self.arrivals.zone] = self.arrivals.camera
        return camera

    def range_of(self, source: Ints, target: Ints) -> Ints:
        """Return the range (n,) of the lags from zones ``source`` to zones ``target``, (n,)."""
        return source if self.ranges is None else self.ranges.of[source, target]

    def delays(self, source: Ints, target: Ints) -> Floats:
        """Return the delay (n,) of the lags from zones ``source`` to zones ``target``, (n,)."""
        if self.ranges is None:
            return np.zeros(len(source))
        return self.ranges.delay[self.ranges.of[source, target]]

    def odds_of(self, source: Ints, target: Ints) -> Floats | None:
        """Return the odds (n,) of paths from zones ``source`` to zones ``target``; None for 1."""
        if self.odds is None:
            return None
        camera = self.cameras()
        odds: Floats = self.odds[camera[source], camera[target]]
        return odds

    @property
    def range_count(self) -> int:
        """Number of ranges, R."""
        return self.zones if self.ranges is None else len(self.ranges.zone)

    def delayed_departures(self) -> tuple[Ints, Floats, Floats]:
        """Return range, delayed time, and time of entry of the departures of each range, (N,).

        The time of entry (seconds) is -inf where lags are delayed.
        """
        d = self.departures
        if self.ranges is None:
            return d.zone, d.t, d.since
        of_zone = rows_by_group(d.zone, self.zones)
        rows = [of_zone[zone] for zone in self.ranges.zone]
        number = np.repeat(
            np.arange(len(rows), dtype=np.int32), [len(range_rows) for range_rows in rows]
        )
        row = np.concatenate(rows)
        delay = self.ranges.delay[number]
        return number, d.t[row] + delay, np.where(delay > 0.0, -np.inf, d.since[row])


def exposures(problem: Problem) -> Floats:
    """Return the number of departures exposed to each bin of each range of lags, (R, bins).

    Hazards are rates per exposed departure. A departure shortly before the end of the window is not
    exposed to long lags, as an arrival after such a lag would not be in the window yet; and it is
    exposed to negative lags (an arrival in an overlapping view before the exit) only up to the
    duration of its passage.

    A departure is exposed to a lag bin after the exit if the window reaches past the bin. It is
    exposed to a lag bin before the exit as far as its passage had begun by then, possibly in part.
    """
    bins = problem.bins
    number, t, since = problem.delayed_departures()
    result = np.zeros((problem.range_count, bins.size))
    ahead = int((bins.edges[1:] <= 0).sum())
    before = bins.edges[: ahead + 1]
    for k, rows in enumerate(rows_by_group(number, len(result))):
        # Lags after the exit: departures that are at least the lag before the end of the window.
        seconds_left = np.sort(problem.until - t[rows])
        result[k] = len(rows) - np.searchsorted(seconds_left, bins.edges[1:], side="left")

        # Lags before the exit: mean number of objects in view within each bin, as the difference of
        # the cumulative seconds in view at its edges. This also holds where a bin is exposed in
        # part: if all passages last equally long, the few exposed seconds of their last bin would
        # otherwise look like a peak.
        dwell = np.sort(np.minimum(t[rows] - since[rows], -bins.edges[0]))
        shorter = np.searchsorted(dwell, -before, side="right")
        longer = np.append(np.cumsum(dwell[::-1])[::-1], 0.0)[shorter]
        result[k, :ahead] = np.diff(longer + (len(rows) - shorter) * before) / bins.widths[:ahead]
    return result
