"""Kinds of networks to measure on: those of the targets, simulated twins of real ones,
disturbances.
"""

from __future__ import annotations

import msgspec
from msgspec import Struct

from bench.scenes.crowd import CrowdSettings, simulate_crowd
from bench.scenes.hall import HallSettings, simulate_hall
from bench.scenes.road import RoadSettings, simulate_road
from bench.scenes.walkway import WalkwaySettings, simulate_walkway
from camtopod.learn.settings import Settings as LearnSettings
from camtopod.records import Event
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.sim.truth import Truth

Settings = SimSettings | HallSettings | CrowdSettings | WalkwaySettings | RoadSettings
"""Settings of any simulation."""


class Regime(Struct, frozen=True):
    """A kind of network; every seed gives another one."""

    name: str
    about: str
    settings: Settings
    window_events: int | None = None
    """Events that the learner keeps; None: the default."""

    def learning(self, scale: float = 1.0) -> LearnSettings:
        """Return the learner's settings; a shorter recording has a shorter window."""
        if self.window_events is None:
            return LearnSettings()
        return LearnSettings(
            window_events=round(scale * self.window_events), window_camera_events=0
        )

    def make(self, seed: int, scale: float = 1.0) -> tuple[list[Event], Truth]:
        """Simulate a network and return its events and ground truth.

        ``scale`` below 1 makes a shorter recording of the same network (and day).
        """
        chosen = msgspec.structs.replace(_scaled(self.settings, scale), seed=seed)
        match chosen:
            case SimSettings():
                return simulate(chosen)
            case HallSettings():
                return simulate_hall(chosen)
            case CrowdSettings():
                return simulate_crowd(chosen)
            case WalkwaySettings():
                return simulate_walkway(chosen)
            case RoadSettings():
                return simulate_road(chosen)


def _scaled(settings: Settings, scale: float) -> Settings:
    """Return the settings of a recording ``scale`` times as long."""
    if isinstance(settings, SimSettings):
        lost = tuple((camera, begin * scale, end * scale) for camera, begin, end in settings.lost)
        moved = tuple((camera, since * scale) for camera, since in settings.moved)
        hours, rhythm_hours = settings.hours * scale, settings.rhythm_hours * scale
        return msgspec.structs.replace(
            settings, hours=hours, rhythm_hours=rhythm_hours, lost=lost, moved=moved
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
    clocks = change(medium, clock_max=30.0, clock_share=1 / 3)
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
        Regime("clocks", "a third of the clocks off by up to 30 s", clocks),
        Regime(
            "clocks-uneven",
            "the same, paths 10 % longer or shorter in each direction",
            change(clocks, uneven=0.1),
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

    def like(name: str, about: str, **changes: object) -> Regime:
        return Regime(name, about, msgspec.structs.replace(usual, **changes))

    lost = (("cam05", 4000.0, 7000.0), ("cam09", 7500.0, 10800.0))
    return [
        like("platoons", "half of the people come in groups of ten", platoons=0.5),
        like("groups", "a third of the people walk with one to three others", group_share=0.33),
        like("loitering", "15 % linger 5 to 30 times as long", loiterers=0.15),
        like("two-speeds", "30 % at less than half the speed", slow_share=0.3),
        like("closing-door", "two paths close half-way", doors_closed=2),
        like("opening-door", "two paths open half-way", doors_opened=2),
        like("lost-camera", "one camera silent for a while, one for good", lost=lost),
        like(
            "moved-camera",
            "two cameras turned elsewhere half-way",
            moved=(("cam03", 5400.0), ("cam08", 5400.0)),
        ),
        like("one-way", "half of the paths taken in one direction only", one_way=0.5),
        like("no-tracks", "no track ids: entries are not tied to exits", tracks=False),
        like("no-positions", "one zone per camera", positions=False),
        like("fire-doors", "four cameras with a door that sees 1 % of the events", fire_doors=4),
        like("near-doors", "zones from 0.12 of the image apart", zone_separation=0.12),
        like("long-zones", "zones three times as long", zone_stretch=3.0),
    ]


OVERLAPPED_PER_CAMERA = 0.8
"""Overlapping pairs per camera with which 40 % of the links are overlapped."""
REGIMES: dict[str, Regime] = {
    regime.name: regime for regime in (*_rows(), *_twins(), *_disturbed())
}
"""All regimes by name."""
