"""The second opinion of a site: where it is asked for, and the paths that are published."""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats, first_of_group, places
from camtopod.columns import figures, packed
from camtopod.learn.assemble import zone_id
from camtopod.learn.limits import PATH_CAMERAS_MAX
from camtopod.learn.links import NEXT_ZONES_MAX, PathEvidence
from camtopod.learn.paths.camera_lags import camera_lags
from camtopod.learn.paths.dictionary import find_peaks
from camtopod.learn.paths.path_fit import PathFit
from camtopod.learn.traffic import Scene
from camtopod.records import PathColumns
from camtopod.topology import favours

DEPARTURES_PER_ZONE = 40.0
"""Departures per zone from which the fit by zones needs no second opinion, given positions."""
PLATOON_NATS = 0.05
"""Mean gain of the rhythm of the zones over an even rate, nats an arrival, with which paths lead
between zones: signals make platoons, which tell paths worse than their bins resolve.
"""
PLATOON_DEPARTURES_PER_ZONE = 150.0
"""Departures per zone from which platoons need no second opinion."""


def is_wanted(scene: Scene, cameras: int) -> bool:
    """Return True if the fit by zones needs a second opinion.

    cameras: number of cameras; on a large site the answer is False.
    """
    return cameras <= PATH_CAMERAS_MAX and (_is_few(scene) or _has_platoons(scene))


def _is_few(scene: Scene) -> bool:
    """Return True if positions or departures are too few for the fit by zones alone."""
    has_shapes = any(zone.shape is not None for zone in scene.zones)
    return not has_shapes or len(scene.departures.t) < DEPARTURES_PER_ZONE * len(scene.zones)


def _has_platoons(scene: Scene) -> bool:
    """Return True if rhythm tells much of the arrivals, and zones have not many departures."""
    weight = scene.arrivals.weight
    nats = 0.0 if weight is None else -float(np.log(np.maximum(weight, 1e-9)).mean())
    is_few = len(scene.departures.t) < PLATOON_DEPARTURES_PER_ZONE * len(scene.zones)
    return is_few and nats >= PLATOON_NATS


def second_opinion(
    scene: Scene,
    cameras: list[str],
    lag_min: float,
    odds: Floats | None = None,
    label_persistence: float = 0.0,
) -> tuple[PathColumns, PathEvidence | None]:
    """Return the paths, sorted by their ends and place, and the evidence for links.

    There is no evidence (None) where paths lead between zones.

    cameras: names of all cameras.
    lag_min (seconds): least lag.
    odds (cameras, cameras): odds of a path by what was declared; None for 1.
    label_persistence: share of the objects whose label persists.
    """
    by_zone = not _is_few(scene)
    favour = favours(np.ones((len(cameras), len(cameras))) if odds is None else odds)
    if by_zone:
        view = np.array([zone.camera for zone in scene.zones])
        favour = favour[view[:, None], view]
        cameras = [zone_id(cameras, zone) for zone in scene.zones]
    lags = camera_lags(
        scene.departures,
        scene.arrivals,
        len(cameras),
        lag_min,
        scene.last,
        by_zone,
        label_persistence,
    )
    fit = PathFit(lags, favour.ravel(), *find_peaks(lags, favour))
    fit.run()
    if by_zone:
        fit.run()

    # The likeliest paths of each end, by the places of their ends in the topology.
    pair, share, place, width = fit.paths
    source, target = pair // len(cameras), pair % len(cameras)
    order = np.argsort(-share, kind="stable")
    order = order[first_of_group(source[order], NEXT_ZONES_MAX)]
    sorted_place = places(cameras)
    source, target = sorted_place[source[order]], sorted_place[target[order]]
    row = np.lexsort((place[order], target, source))
    paths = PathColumns(
        by_zone,
        packed(source[row], np.int32),
        packed(target[row], np.int32),
        *(figures(column[order[row]]) for column in (share, place, width)),
    )
    return paths, None if by_zone else fit.evidence()
