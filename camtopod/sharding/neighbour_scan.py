"""Find possible neighbours of a district: a coarse scan of all received cameras.

The joint fit of a district uses few cameras. This scan finds further cameras whose departures seem
to be followed by arrivals at the district's own cameras, with the test that `learn.association`
uses for screening.
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Bools
from camtopod.learn.association import excess_by_source, screen_input
from camtopod.learn.traffic import Scene
from camtopod.topology import LagBins

STANDS_OUT_SD = 3.0
"""Least excess over the null model, in standard deviations, that makes a camera nearby.

It is the excess of arrivals at an own camera after the other camera's departures, at the best lag
of any pair of their zones.
"""
NEARBY_PER_CAMERA_MAX = 4
"""Largest number of nearby cameras of one own camera; other own cameras count towards it."""


def find_nearby(scene: Scene, own: Bools, bins: LagBins) -> Bools:
    """Return a mask (cameras,) of the nearby cameras of a district, without its own.

    scene: the labelled events of all received cameras.
    own (cameras,): mask of the cameras that belong to the district.
    bins: bins of the lags.
    """
    camera_of = np.array([zone.camera for zone in scene.zones], np.intp)
    ends = screen_input(scene.departures, scene.arrivals, bins, len(camera_of), scene.last)

    # Largest excess (cameras, cameras) from each camera to each own camera.
    clearest = np.full((len(own), len(own)), -np.inf)
    for zone in np.flatnonzero(own[camera_of]):
        np.maximum.at(clearest[:, camera_of[zone]], camera_of, excess_by_source(ends, int(zone)))

    # The cameras with the largest excess at each own camera.
    nearby = np.zeros(len(own), np.bool_)
    for own_camera in np.flatnonzero(own):
        others = clearest[:, own_camera]
        others[own_camera] = -np.inf
        first = np.argsort(-others, kind="stable")[:NEARBY_PER_CAMERA_MAX]
        nearby[first[others[first] > STANDS_OUT_SD]] = True
    return nearby & ~own


def with_cameras(scene: Scene, kept: Bools) -> Scene:
    """Return the scene with departures and arrivals of some cameras only.

    kept (cameras,): mask of these cameras.
    """
    kept_arrivals = kept[scene.arrivals.camera]
    departures = scene.departures.take(kept[scene.departures.camera], kept_arrivals)
    return scene._replace(departures=departures, arrivals=scene.arrivals.take(kept_arrivals))
