"""Disturbances of a simulated recording: what happens to the cameras of a network.

Each function takes events by time and their ground truth, with the settings of the simulation, and
returns both, disturbed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from camtopod.arrays import Floats
from camtopod.records import Event
from camtopod.sim.settings import SimSettings
from camtopod.sim.truth import Truth

CLOCK_SECONDS_MAX = 30.0
"""Largest error of a wrong clock, seconds."""
TURNED_RADIANS = (0.7, 2.4)
"""Range of the angle by which a turned camera rotates its zones about the image's centre."""
Recording = tuple[list[Event], Truth]
"""Events by time, and their ground truth."""


def with_outages(
    recording: Recording, settings: SimSettings, outages: Sequence[tuple[str, float, float]]
) -> Recording:
    """Leave out what cameras report in their outages: camera, begin, end (shares of the time)."""
    events, truth = recording
    seconds = 3600.0 * settings.hours

    def is_out(event: Event) -> bool:
        share = (event.t - settings.start) / seconds
        return any(event.camera == name and begin <= share < end for name, begin, end in outages)

    return _taken(events, truth, [k for k, event in enumerate(events) if not is_out(event)])


def with_wrong_clocks(
    recording: Recording, settings: SimSettings, share: float = 1 / 3
) -> Recording:
    """Let a share of the cameras' clocks be wrong, by up to `CLOCK_SECONDS_MAX`."""
    events, truth = recording
    rng = np.random.default_rng((settings.seed, 4))
    wrong = rng.permutation(settings.cameras) < round(share * settings.cameras)
    errors = rng.uniform(-CLOCK_SECONDS_MAX, CLOCK_SECONDS_MAX, settings.cameras)
    offsets = np.round(np.where(wrong, errors, 0.0), 6).tolist()
    offset = dict(zip(truth.cameras, offsets, strict=True))
    late = [replace(event, t=round(event.t + offset[event.camera], 6)) for event in events]
    by_time = sorted(range(len(late)), key=lambda k: late[k].t)
    return _taken(late, replace(truth, clock_offsets=offset), by_time)


def with_turned_cameras(
    recording: Recording, settings: SimSettings, cameras: Sequence[str]
) -> Recording:
    """Turn cameras half-way; the ground truth has their zones where they are afterwards."""
    events, truth = recording
    rng = np.random.default_rng((settings.seed, 4))
    turns = {camera: _turn(rng) for camera in cameras}
    half_way = settings.start + settings.half_way
    turned_events = []
    for event in events:
        if event.camera in turns and event.t >= half_way:
            x, y = _turned((event.x, event.y), turns[event.camera])
            event = replace(event, x=x, y=y)
        turned_events.append(event)
    zones = []
    for zone in truth.zones:
        if zone.camera in turns:
            turn = turns[zone.camera]
            x, y = _turned((zone.x, zone.y), turn)
            zone = replace(zone, x=x, y=y, cov=(turn @ np.array(zone.cov) @ turn.T).tolist())
        zones.append(zone)
    return turned_events, replace(truth, zones=zones)


def without_tracks(recording: Recording, settings: SimSettings) -> Recording:
    """Leave out all tracks."""
    events, truth = recording
    return [replace(event, track=None) for event in events], truth


def without_positions(recording: Recording, settings: SimSettings) -> Recording:
    """Leave out all positions."""
    events, truth = recording
    zones = [replace(zone, x=None, y=None, cov=None) for zone in truth.zones]
    return [replace(event, x=None, y=None) for event in events], replace(truth, zones=zones)


def _taken(events: Sequence[Event], truth: Truth, index: Sequence[int]) -> Recording:
    """Return the events at ``index`` and what the truth says about them."""
    identity, passage, zone = (
        [column[k] for k in index] for column in (truth.identity, truth.passage, truth.zone)
    )
    return [events[k] for k in index], replace(truth, identity=identity, passage=passage, zone=zone)


def _turn(rng: np.random.Generator) -> Floats:
    """Return the matrix of a random turn, which brings zones nearer to the image's centre."""
    angle = rng.choice((-1.0, 1.0)) * rng.uniform(*TURNED_RADIANS)
    return 0.8 * np.array(((math.cos(angle), -math.sin(angle)), (math.sin(angle), math.cos(angle))))


def _turned(at: tuple[float | None, float | None], turn: Floats) -> list[float]:
    """Return the position, in fractions of the image, after a turn."""
    place = np.clip(0.5 + turn @ (np.array(at, dtype=float) - 0.5), 0.0, 1.0)
    result: list[float] = np.round(place, 4).tolist()
    return result
