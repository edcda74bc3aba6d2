"""Settings of a simulated camera network."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

Share = Annotated[float, Meta(ge=0, le=1)]
Positive = Annotated[float, Meta(gt=0, le=1e10)]
Count = Annotated[int, Meta(ge=0)]


class SimSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of a simulation; shares are in [0, 1], times are seconds unless the name says
    otherwise.
    """

    cameras: Annotated[int, Meta(ge=1)] = 12
    hours: Positive = 1.5
    seed: Count = 0
    start: Annotated[float, Meta(ge=0, le=3e10)] = 1_700_000_000.0
    """Event time at which the recording begins."""
    objects_per_second: Positive | None = None
    """Walkers that enter the network per second; by default 0.4 for 12 cameras, and in
    proportion.
    """
    overlap_share: Share = 0.25
    """Overlapping pairs of cameras, as a share of the number of cameras."""
    linked: bool = True
    """False: no paths between cameras, so each walker appears in one view only."""
    missed: Share = 0.1
    """Share of the passages of which neither event is recorded."""
    clutter: Annotated[float, Meta(ge=0, lt=1)] = 0.1
    """Share of the events that belong to no object."""
    rhythm: Share = 0.0
    """Amplitude of the day/night rhythm: the rate swings by this share."""
    rhythm_hours: Positive = 24.0
    """Period of the day/night rhythm."""
    loiterers: Share = 0.0
    """Share of the walkers with 5 to 30 times the dwell time in every view."""
    slow_share: Share = 0.0
    """Share of the walkers at less than half the speed."""
    doors_closed: Count = 0
    """Number of paths (both directions) that close half-way."""
    doors_opened: Count = 0
    """Number of paths (both directions) that nobody takes before they open half-way."""
    labels: dict[str, Share] = {}
    """Share of the walkers with each label; the others have none."""

    @property
    def half_way(self) -> float:
        """Seconds after the start at which doors close and open."""
        return 1800.0 * self.hours
