"""Likely neighbours: cameras between which objects seem to go, by a coarse look at many events.

The look is that of `learn.association.screening`: for each two zones, by how much the arrivals at
one after departures from the other exceed the null model. People come back by the zones through
which they went, and take as long, so the excess of both directions at like lags counts together.
Two cameras have the largest excess of their pairs of zones. Of unrelated cameras that is the
largest of many, which Gumbel's distribution describes (Coles 2001, An Introduction to Statistical
Modeling of Extreme Values, 3.1); its two parameters follow from two quantiles over all pairs of
cameras, of which few are related.

No joint fit is needed, whose memory grows with the city. Links of little traffic are missed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import islice, pairwise

import numpy as np

from camtopod.arrays import Floats, Ints, Singles
from camtopod.event_time import microseconds
from camtopod.learn.association import Problem, Traffic
from camtopod.learn.camera_zones import zones_of_cameras
from camtopod.learn.lag_range import find_lag_bins
from camtopod.learn.settings import Settings
from camtopod.learn.traffic import label_events
from camtopod.learn.window import Window
from camtopod.records import Event

EVENTS_AT_ONCE = 10_000
"""Events that are put into the window together."""
ZONES_AT_ONCE = 64
"""Zones of arrival that are looked at together."""
CHANCE_NEIGHBOURS = 1.0
"""Unrelated cameras that chance makes likely neighbours of a camera, on average."""
QUANTILES = (0.5, 0.9)
"""Quantiles over all pairs of cameras from which the distribution of unrelated ones follows."""


def likely_neighbours(
    events: Iterable[Event], settings: Settings | None = None
) -> dict[tuple[str, str], float]:
    """Return the likely neighbours, as sorted pairs of cameras, and how clear each pair is.

    events: in order of time; the newest that the learner's window holds count.

    A pair has its excess over the null model, in standard deviations. Zones are compared with each
    other, which takes 3 bytes for each pair of zones.
    """
    settings = settings or Settings()
    window = Window(
        settings.window_events, settings.window_camera_events, settings.window_events_max
    )
    events = iter(events)
    while batch := [(microseconds(event.t), event) for event in islice(events, EVENTS_AT_ONCE)]:
        window.append(batch)
        window.forget_old(batch[-1][0] - microseconds(settings.window_hours * 3600.0))
    scene = label_events(window, zones_of_cameras(window)) if len(window) else None
    if scene is None or not (len(scene.departures.t) and len(scene.arrivals.t)):
        return {}

    no_overlap = np.zeros((len(window.cameras), len(window.cameras)), np.bool_)
    bins = find_lag_bins(scene, no_overlap)
    problem = Problem(scene.departures, scene.arrivals, bins, len(scene.zones), scene.last)
    camera = np.array([zone.camera for zone in scene.zones], np.int32)
    excess = camera_excess(problem, camera)
    above = np.triu(excess > chance_excess(excess[np.triu_indices_from(excess, 1)]), 1)
    names = [window.cameras[number] for number in np.unique(camera).tolist()]
    pairs = {(names[a], names[b]): float(excess[a, b]) for a, b in np.argwhere(above).tolist()}
    return {(min(pair), max(pair)): value for pair, value in pairs.items()}


def camera_excess(problem: Problem, camera: Ints) -> Singles:
    """Return the excess over the null model of each two of the n cameras with zones, (n, n).

    camera (zones,): camera of each zone, ascending.

    The excess is in standard deviations: the largest, over their pairs of zones, of that in one
    direction, and of both together where their lags are alike.
    """
    zones = problem.zones
    traffic = Traffic(problem)
    excess, peak = np.empty((zones, zones), np.float16), np.empty((zones, zones), np.int8)
    for first in range(0, zones, ZONES_AT_ONCE):
        targets = np.arange(first, min(first + ZONES_AT_ONCE, zones))
        above, peak[:, targets] = traffic.peaks(targets)
        excess[:, targets] = np.minimum(above, np.finfo(np.float16).max)

    # The largest of the zones of each two cameras; those of a camera stand side by side.
    begin = np.flatnonzero(np.diff(camera, prepend=-1))
    result = np.empty((len(begin), len(begin)), np.float32)
    for row, (first, end) in enumerate(pairwise([*begin.tolist(), zones])):
        forward, backward = excess[first:end].astype(np.float32), excess[:, first:end].T
        is_alike = np.abs(peak[first:end] - peak[:, first:end].T) <= 1
        two_way = np.where(is_alike, (forward + backward) / math.sqrt(2.0), 0.0)
        largest = np.maximum(forward, two_way).max(axis=0)
        result[row] = np.maximum.reduceat(largest, begin)
    return np.maximum(result, result.T)


def chance_excess(values: Singles | Floats) -> float:
    """Return the excess above which chance makes `CHANCE_NEIGHBOURS` neighbours of a camera.

    values: excess of all pairs of cameras, most of which are unrelated; infinite without any.
    """
    if not len(values):
        return math.inf
    low, high = np.quantile(values, QUANTILES)
    low_gumbel, high_gumbel = (-math.log(-math.log(share)) for share in QUANTILES)
    cameras = math.sqrt(2.0 * len(values))  # or half a camera less
    gumbel = -math.log(-math.log1p(-min(CHANCE_NEIGHBOURS / cameras, 0.5)))
    return float(low + (high - low) * (gumbel - low_gumbel) / (high_gumbel - low_gumbel))
