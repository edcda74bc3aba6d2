"""Objects that no hazard explains: a part of those said to leave may appear again, anywhere.

The learner says how many of them may (`camtopod.learn.next_camera.unknown`); they are shared among
the other cameras by the arrivals there that no departure explains, at any lag.
"""

from __future__ import annotations

import numpy as np

from camtopod.predict.odds import Site
from camtopod.records import NextCamera

NEXT_PROBABILITY_MIN = 1e-4
"""Least probability of an outcome that is listed in a prediction."""


def anywhere(
    site: Site, zone: int, leave: float, next_: list[NextCamera], t: float, now: float | None
) -> tuple[float, list[NextCamera]]:
    """Return the probability of leaving and the outcomes, with the unknown part shared out.

    zone: index of the zone of the exit.
    leave: probability of leaving, the unknown part included.
    next_: the other outcomes.
    t (seconds by the camera's clock): time of the exit.
    now: moment of the question; None for the moment of the exit.
    """
    entering = site.entering.copy()
    entering[site.camera_of[zone]] = 0.0
    if not site.unknown[zone] or not entering.any():
        return leave, next_

    # The part that may appear later than now, shared out.
    lag_max = site.hazards.bins.lag_max
    elapsed = min(max((now or t) - t, 0.0), lag_max)
    odds = site.unknown[zone] * (1.0 - elapsed / lag_max)
    share = leave * odds * entering / entering.sum()
    share[share < NEXT_PROBABILITY_MIN] = 0.0

    # One more row for each camera, the likeliest first.
    rows = list(next_)
    for camera in np.flatnonzero(share).tolist():
        busiest = site.busiest[camera]
        target = site.zones[busiest]
        lags = elapsed + np.array((0.1, 0.5, 0.9)) * (lag_max - elapsed)
        if not site.is_corrected:
            lags += site.offset_of[busiest] - site.offset_of[zone]
        window = np.round(lags, 3).tolist()
        rows.append(NextCamera(target.camera, target.id, float(share[camera]), *window))
    likeliest = sorted(rows, key=lambda row: -row.probability)
    return leave - float(share.sum()), likeliest
