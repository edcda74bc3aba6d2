"""Kinds of networks to measure on: those of the targets, simulated twins of real ones,
disturbances.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import msgspec
from msgspec import Struct

from bench.scene import SCENES
from bench.scenes.crowd import CrowdSettings
from bench.scenes.hall import HallSettings
from bench.scenes.road import RoadSettings
from bench.scenes.walkway import WalkwaySettings
from bench.support.disturbances import (
    Recording,
    with_outages,
    with_turned_cameras,
    with_wrong_clocks,
    without_positions,
    without_tracks,
)
from camtopod.learn.settings import Settings as LearnSettings
from camtopod.sim.simulation import SimSettings, simulate

Settings = SimSettings | HallSettings | CrowdSettings | WalkwaySettings | RoadSettings
"""Settings of any simulation."""
_SIMULATIONS = dict(SCENES.values())
"""Simulation of a scene by the type of its settings."""


class Regime(Struct, frozen=True):
    """A kind of network; every seed gives another one."""

    name: str
    about: str
    settings: Settings
    window_events: int | None = None
    """Events that the learner keeps; None: the default."""
    disturb: Callable[[Recording, SimSettings], Recording] | None = None
    """What happens to the cameras of a simulated network."""

    def learning(self, scale: float = 1.0) -> LearnSettings:
        """Return the learner's settings; a shorter recording has a shorter window."""
        if self.window_events is None:
            return LearnSettings()
        return LearnSettings(
            window_events=round(scale * self.window_events), window_camera_events=0
        )

    def make(self, seed: int, scale: float = 1.0) -> Recording:
        """Simulate a network and return its events and ground truth.

        ``scale`` below 1 makes a shorter recording of the same network (and day).
        """
        settings = msgspec.structs.replace(_scaled(self.settings, scale), seed=seed)
        if not isinstance(settings, SimSettings):
            return _SIMULATIONS[type(settings)](settings)
        recording = simulate(settings)
        if self.disturb is None:
            return recording
        return self.disturb(recording, settings)


def _scaled(settings: Settings, scale: float) -> Settings:
    """Return the settings of a recording ``scale`` times as long."""
    if isinstance(settings, SimSettings):
        return msgspec.structs.replace(
            settings, hours=settings.hours * scale, rhythm_hours=settings.rhythm_hours * scale
        )
    return msgspec.structs.replace(settings, seconds=settings.seconds * scale)


def _rows() -> list[Regime]:
    """Return the regimes of the targets.

    12 cameras with 2 to 5 zones, 10 % missed and 10 % clutter, unless stated otherwise.
    """
    sparse = SimSettings(objects_per_second=0.05, hours=34.0)
    medium = SimSettings(objects_per_second=0.12, hours=14.0)
    dense = SimSettings(objects_per_second=0.6, hours=2.8)
    change = msgspec.structs.replace
    day = SimSettings(objects_per_second=0.07, hours=24.0, rhythm=0.9)
    alone = SimSettings(objects_per_second=0.3, hours=24.0, rhythm=0.9, linked=False)
    return [
        Regime("zones-10", "10 % clutter, for the zones", SimSettings(hours=1.5, clutter=0.1)),
        Regime("zones-30", "30 % clutter, for the zones", SimSettings(hours=1.5, clutter=0.3)),
        Regime("sparse", "0.05 objects a second, about 50,000 events", sparse),
        Regime("medium", "0.12 objects a second, about 50,000 events", medium),
        Regime("dense", "0.6 objects a second, about 50,000 events", dense),
        Regime("rhythm", "a day with a rhythm of +-90 %, about 50,000 events", day),
        Regime(
            "rhythm-sparse",
            "0.05 objects a second, +-90 % in 34 hours",
            change(sparse, rhythm=0.9, rhythm_hours=34.0),
        ),
        Regime(
            "rhythm-medium",
            "0.12 objects a second, +-90 % in 14 hours",
            change(medium, rhythm=0.9, rhythm_hours=14.0),
        ),
        Regime(
            "rhythm-dense",
            "0.6 objects a second, +-90 % in 2.8 hours",
            change(dense, rhythm=0.9, rhythm_hours=2.8),
        ),
        Regime(
            "faulty",
            "25 % missed, 30 % clutter, about 50,000 events",
            change(medium, missed=0.25, clutter=0.3),
        ),
        Regime("no-links", "every object at one camera only, a day with a rhythm of +-90 %", alone),
        Regime(
            "short", "3 hours, about 9,000 events", SimSettings(objects_per_second=0.108, hours=3.0)
        ),
        Regime(
            "overlapped",
            "40 % of the links overlapped",
            change(medium, overlap_share=OVERLAPPED_PER_CAMERA),
        ),
        Regime(
            "windows",
            "0.12 objects a second, five times what the learner keeps",
            medium,
            window_events=10_000,
        ),
        Regime(
            "clocks", "a third of the clocks off by up to 30 s", medium, disturb=with_wrong_clocks
        ),
    ]


def _twins() -> list[Regime]:
    """Return regimes like real networks on which a topology is hard to learn."""
    return [
        Regime("hall", "station hall, 7 overlapping views with open borders", HallSettings()),
        Regime(
            "crowd", "open square, 7 strongly overlapping views, long dwell times", CrowdSettings()
        ),
        Regime(
            "walkway",
            "6 cameras on a campus, few people, cameras that start late or end early",
            WalkwaySettings(),
        ),
        Regime(
            "road",
            "20 cameras in a town, vehicles without positions, traffic lights",
            RoadSettings(),
        ),
    ]


def _disturbed() -> list[Regime]:
    """Return regimes with one disturbance each.

    The network has the usual traffic for three hours (about 35,000 events).
    """
    usual = SimSettings(hours=3.0)
    change = msgspec.structs.replace
    loss = partial(with_outages, outages=(("cam05", 0.37, 0.65), ("cam09", 0.69, 1.0)))
    turned = partial(with_turned_cameras, cameras=("cam03", "cam08"))
    return [
        Regime("loitering", "15 % linger 5 to 30 times as long", change(usual, loiterers=0.15)),
        Regime("two-speeds", "30 % at less than half the speed", change(usual, slow_share=0.3)),
        Regime("closing-door", "two paths close half-way", change(usual, doors_closed=2)),
        Regime("opening-door", "two paths open half-way", change(usual, doors_opened=2)),
        Regime("lost-camera", "one camera silent for a while, one for good", usual, disturb=loss),
        Regime("moved-camera", "two cameras turned elsewhere half-way", usual, disturb=turned),
        Regime(
            "no-tracks",
            "no track ids: entries are not tied to exits",
            usual,
            disturb=without_tracks,
        ),
        Regime("no-positions", "one zone per camera", usual, disturb=without_positions),
    ]


OVERLAPPED_PER_CAMERA = 0.8
"""Overlapping pairs per camera with which 40 % of the links are overlapped."""
REGIMES: dict[str, Regime] = {
    regime.name: regime for regime in (*_rows(), *_twins(), *_disturbed())
}
"""All regimes by name."""
