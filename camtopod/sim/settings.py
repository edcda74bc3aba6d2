"""What can be asked of a made-up camera network."""

from __future__ import annotations

import math

from msgspec import Struct

from camtopod.sim.layout import ZONE_SEPARATION

SEPARATION_RANGE = (0.05, 0.3)
STRETCH_RANGE = (1.0, 4.0)
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


class SimSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """What is simulated. Shares are in [0, 1]; times are seconds unless the name says otherwise."""

    cameras: int = 12
    hours: float = 1.5
    seed: int = 0
    start: float = 1_700_000_000.0
    """Event time at which the recording begins."""
    objects_per_second: float | None = None
    """Walkers that enter the network, by default 0.4 for 12 cameras and in proportion."""
    overlap_share: float = 0.25
    """Overlapping pairs of cameras, as a share of the number of cameras."""
    linked: bool = True
    """Whether there are any ways between cameras; without, everybody appears at one camera only."""
    zone_separation: float = ZONE_SEPARATION
    """Least distance of two zones of one camera, fraction of the image."""
    zone_stretch: float = 1.0
    """How many times as long the zones are, along the image's border."""
    fire_doors: int = 0
    """Cameras with a zone that sees about 1 % of their events."""
    uneven: float = 0.0
    """Spread (log scale) of the length of a way in each direction: up the stairs takes longer than
    down.
    """
    one_way: float = 0.0
    """Share of the ways between views that do not overlap that are taken in one direction only."""
    u_turn: float = 0.03
    """Probability of leaving a view where one came in."""
    speed_sd: float = 0.3
    """Spread of the walkers' speeds (log scale); a walker's own speed stays the same."""
    path_sd: float = 0.1
    """Spread (log scale) of one walker's time over one way."""
    missed: float = 0.1
    """Share of passages of which neither event is recorded."""
    clutter: float = 0.1
    """Share of the events that belong to nobody."""
    position_noise: float = 0.0
    """Standard deviation added to x and y, fraction of the image."""
    clock_sd: float = 0.0
    """Standard deviation of the cameras' clock offsets."""
    clock_max: float = 0.0
    """Beside that, the clocks of ``clock_share`` of the cameras are off by up to so many seconds
    (uniform).
    """
    clock_share: float = 0.33
    rhythm: float = 0.0
    """Amplitude of the day/night rhythm: the rate swings by this share."""
    rhythm_hours: float = 24.0
    platoons: float = 0.0
    """Share of the walkers that come in bunches, as off a train or from a traffic light."""
    platoon_size: float = 10.0
    platoon_cycle: float = 90.0
    """Each way in lets a bunch through once in so many seconds."""
    group_share: float = 0.0
    """Share of the walkers with one to three companions a step behind."""
    loiterers: float = 0.0
    """Share of the walkers that linger 5 to 30 times as long in every view."""
    slow_share: float = 0.0
    """Share of the walkers at less than half the speed."""
    doors_closed: int = 0
    """Paths (both directions) that close."""
    close_after_hours: float | None = None
    """When they close, by default half-way."""
    doors_opened: int = 0
    """Paths (both directions) that nobody takes before they open."""
    open_after_hours: float | None = None
    """When they open, by default half-way."""
    lost: tuple[tuple[str, float, float], ...] = ()
    """Intervals (camera, from, to) in seconds after the start in which a camera reports nothing."""
    moved: tuple[tuple[str, float], ...] = ()
    """Cameras that are turned elsewhere (camera, seconds after the start), so that their zones lie
    elsewhere.
    """
    tracks: bool = True
    positions: bool = True

    def closing(self) -> float:
        """Seconds after the start at which doors close."""
        return _half_way(self.hours, self.close_after_hours)

    def opening(self) -> float:
        """Seconds after the start at which doors open."""
        return _half_way(self.hours, self.open_after_hours)


def _half_way(hours: float, after_hours: float | None) -> float:
    return 3600.0 * (hours / 2 if after_hours is None else after_hours)


def check(s: SimSettings) -> None:
    """Raise ValueError for settings that make no sense."""
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
