"""Settings of a simulated camera network."""

from __future__ import annotations

import math

from msgspec import Struct

from camtopod.sim.layout import ZONE_SEPARATION

SEPARATION_RANGE = (0.05, 0.3)
"""Allowed range of ``zone_separation``."""
STRETCH_RANGE = (1.0, 4.0)
"""Allowed range of ``zone_stretch``."""
SHARES = (
    *(
        "missed",
        "group_share",
        "loiterers",
        "slow_share",
        "u_turn",
        "overlap_share",
        "rhythm",
        "platoons",
    ),
    *("clock_share", "one_way"),
)
"""Settings that are shares from 0 to 1."""
NOT_NEGATIVE = (
    *(
        "speed_sd",
        "path_sd",
        "uneven",
        "position_noise",
        "clock_sd",
        "clock_max",
        "doors_closed",
        "doors_opened",
    ),
    *("fire_doors", "seed"),
)
"""Settings that must not be negative."""


class SimSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """Settings of a simulation; shares are in [0, 1], times are seconds unless the name says
    otherwise.
    """

    cameras: int = 12
    hours: float = 1.5
    seed: int = 0
    start: float = 1_700_000_000.0
    """Event time at which the recording begins."""
    objects_per_second: float | None = None
    """Walkers that enter the network per second; by default 0.4 for 12 cameras, and in
    proportion.
    """
    overlap_share: float = 0.25
    """Overlapping pairs of cameras, as a share of the number of cameras."""
    linked: bool = True
    """False: no paths between cameras, so each walker appears in one view only."""
    zone_separation: float = ZONE_SEPARATION
    """Least distance of two zones of one camera, fraction of the image."""
    zone_stretch: float = 1.0
    """Factor on the length of the zones, along the image's border."""
    fire_doors: int = 0
    """Number of cameras with a zone that has about 1 % of their events."""
    uneven: float = 0.0
    """Spread (log scale) of a path's length in each direction, as of stairs up and down."""
    one_way: float = 0.0
    """Share of the paths between views that do not overlap that are walked in one direction
    only.
    """
    u_turn: float = 0.03
    """Probability of leaving a view in the zone of entry."""
    speed_sd: float = 0.3
    """Spread (log scale) of the walkers' speeds; a walker keeps the same speed."""
    path_sd: float = 0.1
    """Spread (log scale) of one walker's time over one path."""
    missed: float = 0.1
    """Share of the passages of which neither event is recorded."""
    clutter: float = 0.1
    """Share of the events that belong to no object."""
    position_noise: float = 0.0
    """Standard deviation added to x and y, fraction of the image."""
    clock_sd: float = 0.0
    """Standard deviation of the cameras' clock offsets, seconds."""
    clock_max: float = 0.0
    """Largest further clock offset (uniform, seconds) of ``clock_share`` of the cameras."""
    clock_share: float = 0.33
    """Share of the cameras with the clock offset of ``clock_max``."""
    rhythm: float = 0.0
    """Amplitude of the day/night rhythm: the rate swings by this share."""
    rhythm_hours: float = 24.0
    """Period of the day/night rhythm."""
    platoons: float = 0.0
    """Share of the walkers that come in platoons, as off a train or from a traffic light."""
    platoon_size: float = 10.0
    """Mean number of walkers in a platoon."""
    platoon_cycle: float = 90.0
    """Seconds between platoons in one zone of entry."""
    group_share: float = 0.0
    """Share of the walkers with one to three companions a step behind."""
    loiterers: float = 0.0
    """Share of the walkers with 5 to 30 times the dwell time in every view."""
    slow_share: float = 0.0
    """Share of the walkers at less than half the speed."""
    doors_closed: int = 0
    """Number of paths (both directions) that close."""
    close_after_hours: float | None = None
    """Hours after which they close, by default half-way."""
    doors_opened: int = 0
    """Number of paths (both directions) that nobody takes before they open."""
    open_after_hours: float | None = None
    """Hours after which they open, by default half-way."""
    lost: tuple[tuple[str, float, float], ...] = ()
    """Outages (camera, from, to) in seconds after the start: the camera reports nothing."""
    moved: tuple[tuple[str, float], ...] = ()
    """Cameras that are turned (camera, seconds after the start), so that their zones move."""
    tracks: bool = True
    """Whether events have a track."""
    positions: bool = True
    """Whether events have x and y."""

    def closing(self) -> float:
        """Return the seconds after the start at which doors close."""
        return _half_way(self.hours, self.close_after_hours)

    def opening(self) -> float:
        """Return the seconds after the start at which doors open."""
        return _half_way(self.hours, self.open_after_hours)


def _half_way(hours: float, after_hours: float | None) -> float:
    """Return ``after_hours``, or half of ``hours`` if it is None, in seconds."""
    return 3600.0 * (hours / 2 if after_hours is None else after_hours)


def check(s: SimSettings) -> None:
    """Raise ValueError for invalid settings."""
    for name in SHARES:
        if not 0 <= getattr(s, name) <= 1:
            raise ValueError(f"{name} is {getattr(s, name)}; it is a share from 0 to 1")
    if not 0 <= s.clutter < 1:
        raise ValueError(f"clutter is {s.clutter}; it is a share from 0 to below 1")
    for name in NOT_NEGATIVE:
        if getattr(s, name) < 0:
            raise ValueError(f"{name} is {getattr(s, name)}; it cannot be negative")
    if s.cameras < 1 or not s.hours > 0 or not s.rhythm_hours > 0 or not math.isfinite(s.start):
        raise ValueError("cameras, hours and rhythm_hours must be positive, start a finite number")
    if s.objects_per_second is not None and not s.objects_per_second > 0:
        raise ValueError(f"objects_per_second is {s.objects_per_second}; it must be positive")
    if not s.platoon_size >= 1 or not s.platoon_cycle > 0:
        raise ValueError("platoon_size must be at least 1 and platoon_cycle positive")
    for name, (low, high) in (
        ("zone_separation", SEPARATION_RANGE),
        ("zone_stretch", STRETCH_RANGE),
    ):
        if not low <= getattr(s, name) <= high:
            raise ValueError(f"{name} is {getattr(s, name)}; it must be from {low:g} to {high:g}")
