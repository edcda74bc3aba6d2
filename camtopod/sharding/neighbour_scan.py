"""Find possible neighbours: a coarse scan of all received cameras before the joint fit of a few."""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Bools
from camtopod.learn.association import excess_by_source, screen_input
from camtopod.learn.traffic import Scene
from camtopod.topology import LagBins

STANDS_OUT_SD = 3.0
"""Least excess of arrivals at an own camera that follow a camera's departures, in standard
deviations of the null model, at the best lag of any pair of their zones. A camera with less is not
nearby.
"""
NEARBY_PER_CAMERA_MAX = 4
"""Cameras, own ones included, that can be nearby to one own camera."""


def find_nearby(scene: Scene, own: Bools, bins: LagBins) -> Bools:
    """Return the nearby cameras as a mask (C,), without own ones.

    own (C,): whether a camera belongs to this district.
    """
    camera_of = np.array([zone.camera for zone in scene.zones], np.intp)
    ends = screen_input(scene.departures, scene.arrivals, bins, len(camera_of), scene.last)

    # Largest excess from each camera to each own camera.
    clearest = np.full((len(own), len(own)), -np.inf)
    for zone in np.flatnonzero(own[camera_of]):
        np.maximum.at(clearest[:, camera_of[zone]], camera_of, excess_by_source(ends, int(zone)))

    # The cameras with the largest excess at each own camera.
    nearby = np.zeros(len(own), np.bool_)
    for here in np.flatnonzero(own):
        others = clearest[:, here]
        others[here] = -np.inf
        first = np.argsort(-others, kind="stable")[:NEARBY_PER_CAMERA_MAX]
        nearby[first[others[first] > STANDS_OUT_SD]] = True
    return nearby & ~own


def with_cameras(scene: Scene, kept: Bools) -> Scene:
    """Return the scene without departures and arrivals of cameras that are not ``kept`` (C,)."""
    came = kept[scene.arrivals.camera]
    left = scene.departures.take(kept[scene.departures.camera], came)
    return scene._replace(departures=left, arrivals=scene.arrivals.take(came))
