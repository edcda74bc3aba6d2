"""The second opinion of a site: its paths, and what becomes of departures that no path explains."""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats
from camtopod.learn.limits import PATH_CAMERAS_MAX
from camtopod.learn.next_camera import LEAVING_CAMERAS
from camtopod.learn.paths.camera_lags import camera_lags
from camtopod.learn.paths.dictionary import find_peaks
from camtopod.learn.paths.path_fit import PathFit
from camtopod.learn.traffic import Scene
from camtopod.records import CameraPath
from camtopod.topology import round_significant

DEPARTURES_PER_ZONE = 40.0
"""Departures per zone from which the fit by zones needs no second opinion, given positions."""
LEAVING_RANGE = (0.25, 0.95)
"""Limits of the share of unexplained departures that leave the site."""
OWN_SHARE = 0.5
"""Odds of coming up again at the same camera over those of another one."""
EARLY_QUANTILE = 0.98
"""Quantile of the dwell times at which the range of lags before the exit ends."""
PATHS_PER_CAMERA_MAX = 32
"""Paths of one camera that are published, the likeliest first."""


def is_wanted(scene: Scene, cameras: int) -> bool:
    """Return True if positions or departures are too few for the fit by zones alone.

    cameras: number of cameras; on a large site the answer is False.
    """
    placed = any(zone.shape is not None for zone in scene.zones)
    few = not placed or len(scene.departures.t) < DEPARTURES_PER_ZONE * len(scene.zones)
    return few and cameras <= PATH_CAMERAS_MAX


def second_opinion(scene: Scene, cameras: list[str], lag_min: float) -> list[CameraPath]:
    """Return the paths between cameras, sorted by cameras and place.

    cameras: names of all cameras.
    lag_min (seconds): least lag.
    """
    # The range of the lags.
    departures = scene.departures
    dwell = departures.t - departures.since
    known = dwell[np.isfinite(dwell)]
    early = float(np.quantile(known, EARLY_QUANTILE)) if len(known) else -lag_min

    # The paths.
    lag_min = max(lag_min, float(np.floor(min(-early, -1.0))))
    lags = camera_lags(departures, scene.arrivals, len(cameras), lag_min, scene.last)
    fit = PathFit(lags, find_peaks(lags))
    fit.run()

    # What no path explains comes up at cameras with unexplained arrivals, at no telling lag.
    elsewhere = _unexplained(fit)
    source, target = elsewhere.nonzero()
    pair = np.concatenate((fit.paths.pair, source * len(cameras) + target))
    none = np.zeros(len(source))
    share, place, width = (
        np.concatenate(both)
        for both in zip(fit.paths[1:], (elsewhere[source, target], none, none), strict=True)
    )

    rows = []
    order = np.argsort(-share, kind="stable")
    for camera, name in enumerate(cameras):
        likely = order[pair[order] // len(cameras) == camera][:PATHS_PER_CAMERA_MAX]
        rows += [
            CameraPath(
                name,
                cameras[int(pair[k]) % len(cameras)],
                *(round_significant(float(x[k])) for x in (share, place, width)),
            )
            for k in likely.tolist()
        ]
    return sorted(rows, key=lambda row: (row.from_, row.to, row.place))


def _unexplained(fit: PathFit) -> Floats:
    """Return the share of each camera's departures that come up at each other one unexplained.

    The result is (cameras, cameras). The share that leaves the site depends on the site's size: of
    all departures, 1 / (1 + cameras / `LEAVING_CAMERAS`) at first sight.
    """
    unexplained = fit.unexplained()
    every = float(fit.departures @ unexplained) / max(float(fit.departures.sum()), 1.0)
    leaving = 1.0 / (1.0 + len(unexplained) / LEAVING_CAMERAS) / every
    stays = 1.0 - min(max(leaving, LEAVING_RANGE[0]), LEAVING_RANGE[1])

    # By the unexplained arrivals of each camera.
    to = np.tile(fit.outside * fit.arrivals + 0.5, (len(unexplained), 1))
    np.fill_diagonal(to, OWN_SHARE * to.diagonal())
    shared: Floats = stays * unexplained[:, None] * to / to.sum(axis=1, keepdims=True)
    return shared
