"""Settings of a simulated camera network."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from camtopod.sim.layout import ZONE_SEPARATION

Share = Annotated[float, Meta(ge=0, le=1)]
Positive = Annotated[float, Meta(gt=0, le=1e10)]
NotNegative = Annotated[float, Meta(ge=0)]
Count = Annotated[int, Meta(ge=0)]


class SimSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of a simulation; shares are in [0, 1], times are seconds unless the name says
    otherwise.
    """

    cameras: Annotated[int, Meta(ge=1)] = 12
    hours: Positive = 1.5
    seed: Count = 0
    start: Annotated[float, Meta(ge=0, le=1e11)] = 1_700_000_000.0
    """Event time at which the recording begins."""
    objects_per_second: Positive | None = None
    """Walkers that enter the network per second; by default 0.4 for 12 cameras, and in
    proportion.
    """
    overlap_share: Share = 0.25
    """Overlapping pairs of cameras, as a share of the number of cameras."""
    linked: bool = True
    """False: no paths between cameras, so each walker appears in one view only."""
    zone_separation: Annotated[float, Meta(ge=0.05, le=0.3)] = ZONE_SEPARATION
    """Least distance of two zones of one camera, fraction of the image."""
    zone_stretch: Annotated[float, Meta(ge=1, le=4)] = 1.0
    """Factor on the length of the zones, along the image's border."""
    fire_doors: Count = 0
    """Number of cameras with a zone that has about 1 % of their events."""
    uneven: NotNegative = 0.0
    """Spread (log scale) of a path's length in each direction, as of stairs up and down."""
    one_way: Share = 0.0
    """Share of the paths between views that do not overlap that are walked in one direction
    only.
    """
    missed: Share = 0.1
    """Share of the passages of which neither event is recorded."""
    clutter: Annotated[float, Meta(ge=0, lt=1)] = 0.1
    """Share of the events that belong to no object."""
    clock_sd: NotNegative = 0.0
    """Standard deviation of the cameras' clock offsets, seconds."""
    clock_max: NotNegative = 0.0
    """Largest further clock offset (uniform, seconds) of ``clock_share`` of the cameras."""
    clock_share: Share = 0.33
    """Share of the cameras with the clock offset of ``clock_max``."""
    rhythm: Share = 0.0
    """Amplitude of the day/night rhythm: the rate swings by this share."""
    rhythm_hours: Positive = 24.0
    """Period of the day/night rhythm."""
    platoons: Share = 0.0
    """Share of the walkers that come in platoons, as off a train or from a traffic light."""
    platoon_size: Annotated[float, Meta(ge=1)] = 10.0
    """Mean number of walkers in a platoon."""
    group_share: Share = 0.0
    """Share of the walkers with one to three companions a step behind."""
    loiterers: Share = 0.0
    """Share of the walkers with 5 to 30 times the dwell time in every view."""
    slow_share: Share = 0.0
    """Share of the walkers at less than half the speed."""
    doors_closed: Count = 0
    """Number of paths (both directions) that close half-way."""
    doors_opened: Count = 0
    """Number of paths (both directions) that nobody takes before they open half-way."""
    lost: tuple[tuple[str, float, float], ...] = ()
    """Outages (camera, from, to) in seconds after the start: the camera reports nothing."""
    moved: tuple[tuple[str, float], ...] = ()
    """Cameras that are turned (camera, seconds after the start), so that their zones move."""
    tracks: bool = True
    """Whether events have a track."""
    positions: bool = True
    """Whether events have x and y."""

    @property
    def half_way(self) -> float:
        """Seconds after the start at which doors close and open."""
        return 1800.0 * self.hours


def check(settings: SimSettings) -> None:
    """Raise ValueError for invalid settings."""
    try:
        msgspec.convert(msgspec.structs.asdict(settings), SimSettings)
    except msgspec.ValidationError as error:
        raise ValueError(str(error)) from None
