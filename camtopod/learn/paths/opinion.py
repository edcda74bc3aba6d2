"""The second opinion of a site: where it is asked for, and the paths that are published."""

from __future__ import annotations

import numpy as np

from camtopod.learn.limits import PATH_CAMERAS_MAX
from camtopod.learn.paths.camera_lags import camera_lags
from camtopod.learn.paths.dictionary import find_peaks
from camtopod.learn.paths.path_fit import PathFit
from camtopod.learn.traffic import Scene
from camtopod.records import CameraPath
from camtopod.topology import round_significant

DEPARTURES_PER_ZONE = 40.0
"""Departures per zone from which the fit by zones needs no second opinion, given positions."""
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
    lags = camera_lags(scene.departures, scene.arrivals, len(cameras), lag_min, scene.last)
    fit = PathFit(lags, *find_peaks(lags))
    fit.run()

    pair, share, place, width = fit.paths
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
