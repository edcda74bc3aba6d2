"""Visible links: passages through the view of one camera, from zone of entry to zone of exit.

A passage is treated as a transition from its zone of entry to its zone of exit, with the dwell time
as lag, so that `link_table` can compute its figures. Where tracks tie exits to entries, passages
are counted. Otherwise the entries and exits of a camera are associated by the joint fit
(`association`), with entries in the role of departures and exits in that of arrivals.
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats, Ints, Longs, rows_by_group
from camtopod.learn.association import (
    Problem,
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
    """Return the passages through all views as transitions, whose lags are dwell times in seconds.

    candidates_max: largest number of candidates in the fits of all cameras without tracks together.
    """
    # Cameras with tracks: count the passages.
    p = scene.departures.passages()
    tracked_rows = np.flatnonzero(scene.is_tracked[p.camera])
    n = len(tracked_rows)
    entry = scene.arrivals.zone[p.own]
    dwell = p.t - p.since
    parts = [
        Transitions(
            entry[tracked_rows], p.zone[tracked_rows], dwell[tracked_rows], np.ones(n), np.zeros(n)
        )
    ]

    # Cameras without tracks: fit each of them, with a fair share of the candidates.
    camera_of = np.array([zone.camera for zone in scene.zones], np.int32)
    views = [
        _view(scene, int(camera), camera_of, bins) for camera in np.flatnonzero(~scene.is_tracked)
    ]
    reach = [
        departures_in_reach(view_problem.departures.t, view_problem.arrivals.t, bins)
        for view_problem, _ in views
    ]
    pairs_max = fair_share(
        np.array([int((high - low).sum()) for low, high in reach], np.intp), candidates_max
    )
    parts.extend(_joined(*view, pairs_max) for view in views)
    return concatenate_transitions(parts)


def passages_lasting(dwell: Floats, entry: Longs, bins: LagBins, zones: int) -> Floats:
    """Return how many passages from each zone of entry last until each bin begins, (zones, bins).

    dwell (n, seconds): dwell time of each of n passages.
    entry (n,): their zones of entry.
    bins: bins of the time since the entry.
    zones: number of zones.
    """
    result = np.zeros((zones, bins.size))
    for zone, rows in enumerate(rows_by_group(entry, zones)):
        dwell_times = np.sort(dwell[rows])
        result[zone] = len(dwell_times) - np.searchsorted(dwell_times, bins.edges[:-1], side="left")
    return result


def with_usual_dwell_times(departures: Departures, through: LinkTable) -> Departures:
    """Return the departures with an estimated time of entry (``since``) where it is unknown.

    The estimate is the time before the exit within which 90 % of the passages that end in the same
    zone begin. With an unknown entry, an object would seem to have been in view forever, and
    earlier appearances in other views would look like an overlap of views.

    through: table of the visible links.
    """
    # Mean of the 90 % quantiles of dwell times, by zone of exit, weighted by the passages.
    dwell = np.nan_to_num(through.transit.quantiles[:, -1])
    weight = through.transit.total
    size = max(int(departures.zone.max(initial=0)), int(through.target.max(initial=0))) + 1
    total = np.bincount(through.target, weight, minlength=size)
    usual = np.bincount(through.target, weight * dwell, minlength=size) / np.maximum(total, 1e-300)

    # Use the mean where the zone of exit has enough passages.
    is_known = np.isfinite(departures.since) | (total[departures.zone] < TRANSITIONS_MIN)
    return departures._replace(
        since=np.where(is_known, departures.since, departures.t - usual[departures.zone])
    )


def _view(scene: Scene, camera: int, camera_of: Ints, bins: LagBins) -> tuple[Problem, int]:
    """Return a camera's entries and exits for the joint fit, and the index of its first zone.

    camera_of (zones,): camera of each zone, ascending.

    In the problem entries are departures and exits arrivals, and zones are numbered from 0.
    """
    is_entry = scene.arrivals.camera == camera
    is_exit = scene.departures.camera == camera
    first, stop = np.searchsorted(camera_of, (camera, camera + 1)).tolist()
    zones = stop - first
    starts = Departures.without_arrivals(
        scene.arrivals.t[is_entry],
        scene.arrivals.zone[is_entry] - np.int32(first),
        scene.arrivals.camera[is_entry],
        scene.arrivals.t[is_entry],
        scene.arrivals.slow[is_entry],
    )

    t = scene.departures.t[is_exit]
    zone = scene.departures.zone[is_exit] - np.int32(first)
    ends = Arrivals(
        t,
        zone,
        scene.departures.camera[is_exit],
        local_rates(t, zone, zones),
        scene.departures.slow[is_exit],
    )
    return Problem(starts, ends, bins, zones, scene.last), first


def _joined(view: Problem, first: int, candidates_max: int) -> Transitions:
    """Return the passages through the view of a camera without tracks, by a joint fit.

    view, first: result of `_view`.
    candidates_max: limit of the candidates, which the newest events meet.
    """
    problem = newest_within_limit(view, candidates_max)
    if len(problem.departures.t) == 0 or len(problem.arrivals.t) == 0:
        return concatenate_transitions([])
    transitions = transitions_of(fit_jointly(problem, find_candidates(problem)))
    return transitions._replace(
        source=transitions.source + np.int32(first), target=transitions.target + np.int32(first)
    )
