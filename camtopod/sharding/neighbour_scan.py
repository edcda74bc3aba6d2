"""Who may be a neighbour: a coarse look at all cameras heard, before a joint fit is made with a few
of them.
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Bools
from camtopod.learn.association import ends_of, followed_above_chance
from camtopod.learn.traffic import Scene
from camtopod.topology import LagBins

STANDS_OUT_SD = 3.0
"""Least excess of arrivals at an own camera that follow a camera's departures, at the best lag of
any pair of their zones, in standard deviations of what chance gives. A camera with less is not
nearby.
"""
NEARBY_PER_CAMERA_MAX = 4
"""Cameras, own ones included, that can be nearby to one own camera: those with the clearest
excess.
"""


def find_nearby(scene: Scene, own: Bools, bins: LagBins) -> Bools:
    """The cameras (C,) that are nearby. ``own`` (C,): whether a camera is one of this
    district's.
    """
    camera_of = np.array([zone.camera for zone in scene.zones], np.intp)
    ends = ends_of(scene.departures, scene.arrivals, bins, len(camera_of), scene.last)
    clearest = np.full((len(own), len(own)), -np.inf)  # from each camera to each
    for zone in np.flatnonzero(own[camera_of]):
        np.maximum.at(
            clearest[:, camera_of[zone]], camera_of, followed_above_chance(ends, int(zone))
        )

    nearby = np.zeros(len(own), np.bool_)
    for here in np.flatnonzero(own):
        others = clearest[:, here]
        others[here] = -np.inf
        first = np.argsort(-others, kind="stable")[:NEARBY_PER_CAMERA_MAX]
        nearby[first[others[first] > STANDS_OUT_SD]] = True
    return nearby & ~own


def with_cameras(scene: Scene, kept: Bools) -> Scene:
    """The scene without who leaves and comes at other cameras than those ``kept`` (C,)."""
    came = kept[scene.arrivals.camera]
    left = scene.departures.take(kept[scene.departures.camera], came)
    return scene._replace(departures=left, arrivals=scene.arrivals.take(came))
