"""Visible links: passages through the view of one camera, from zone of entry to zone of exit.

Where tracks tie an exit to its entry, passages are counted. Otherwise the entries and exits of a
camera are associated by the same joint fit as departures and arrivals of different cameras.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camtopod.arrays import Floats, Longs, rows_by_group
from camtopod.learn.association import (
    departures_in_reach,
    find_candidates,
    fit_jointly,
    newest_within_limit,
)
from camtopod.learn.limits import fair_share
from camtopod.learn.links.link_table import (
    TRANSITIONS_MIN,
    LinkTable,
    Transitions,
    concatenate_transitions,
    transitions_of,
)
from camtopod.learn.traffic import Arrivals, Departures, Scene, local_rates
from camtopod.topology import LagBins


def visible_transitions(scene: Scene, bins: LagBins, candidates_max: int) -> Transitions:
    """Return the transitions through every camera's view; lags are dwell times in seconds.

    candidates_max: candidates that the cameras without tracks may have together.
    """
    # Cameras with tracks: count the passages.
    camera_of = np.array([zone.camera for zone in scene.zones], np.int32)
    tracked = (
        scene.tracked[camera_of[scene.passages.source]]
        if len(scene.passages.source)
        else np.zeros(0, bool)
    )
    p = scene.passages
    n = int(tracked.sum())
    parts = [
        Transitions(
            p.source[tracked],
            p.target[tracked],
            (p.left - p.entered)[tracked],
            np.ones(n),
            np.zeros(n),
        )
    ]

    # Cameras without tracks: fit, with a fair share of the candidates for each.
    views = [_view(scene, int(camera)) for camera in np.flatnonzero(~scene.tracked)]
    reach = [departures_in_reach(view.starts.t, view.ends.t, bins) for view in views]
    most = fair_share(
        np.array([int((high - low).sum()) for low, high in reach], np.intp), candidates_max
    )
    parts.extend(_joined(view, bins, most, scene.last) for view in views)
    return concatenate_transitions(parts)


def passages_lasting(stay: Floats, entry: Longs, bins: LagBins, zones: int) -> Floats:
    """Return the passages from each zone of entry that last until a lag bin begins, (zones, bins).

    stay (n, seconds): dwell times.
    entry (n,): zone of entry.
    """
    result = np.zeros((zones, bins.size))
    for zone, mine in enumerate(rows_by_group(entry, zones)):
        stays = np.sort(stay[mine])
        result[zone] = len(stays) - np.searchsorted(stays, bins.edges[:-1], side="left")
    return result


def with_usual_dwell_times(departures: Departures, through: LinkTable) -> Departures:
    """Return the departures with an estimated beginning where their passage is unknown.

    It is the time at which 90 % of the passages that leave at this zone have begun. Without it
    every object would seem to have been in view forever, and its earlier appearances elsewhere
    would look like an overlap.

    through: figures of the visible links.
    """
    # Mean of the links' 90 % dwell times by zone of exit, weighted by their transitions.
    stay, weight = np.nan_to_num(through.transit.quantiles[:, -1]), through.transit.total
    size = max(int(departures.zone.max(initial=0)), int(through.target.max(initial=0))) + 1
    total = np.bincount(through.target, weight, minlength=size)
    usual = np.bincount(through.target, weight * stay, minlength=size) / np.maximum(total, 1e-300)

    # Use it where the zone has enough transitions.
    known = np.isfinite(departures.since) | (total[departures.zone] < TRANSITIONS_MIN)
    return departures._replace(
        since=np.where(known, departures.since, departures.t - usual[departures.zone])
    )


class _View(NamedTuple):
    """Entries and exits of one camera, as departures and arrivals for the joint fit.

    Zones are numbered from the camera's ``first``, as no others matter here.
    """

    starts: Departures
    ends: Arrivals
    first: int
    zones: int


def _view(scene: Scene, camera: int) -> _View:
    """Return the entries and exits of one camera, with entries as departures."""
    came = scene.arrivals.camera == camera
    left = scene.departures.camera == camera
    of_camera = [index for index, zone in enumerate(scene.zones) if zone.camera == camera]
    first, zones = min(of_camera, default=0), len(of_camera)
    starts = Departures.without_arrivals(
        scene.arrivals.t[came],
        scene.arrivals.zone[came] - np.int32(first),
        scene.arrivals.camera[came],
        scene.arrivals.t[came],
        scene.arrivals.slow[came],
    )

    t, zone = scene.departures.t[left], scene.departures.zone[left] - np.int32(first)
    ends = Arrivals(
        t,
        zone,
        scene.departures.camera[left],
        local_rates(t, zone, zones),
        scene.departures.slow[left],
    )
    return _View(starts, ends, first, zones)


def _joined(view: _View, bins: LagBins, candidates_max: int, until: float) -> Transitions:
    """Return the passages through a camera without tracks, by a joint fit of entries and exits."""
    starts, ends = newest_within_limit(view.starts, view.ends, bins, candidates_max)
    if len(starts.t) == 0 or len(ends.t) == 0:
        return concatenate_transitions([])
    candidates = find_candidates(starts, ends, bins, view.zones)
    found = transitions_of(fit_jointly(starts, ends, candidates, bins, view.zones, until))
    first = np.int32(view.first)
    return found._replace(source=found.source + first, target=found.target + first)
