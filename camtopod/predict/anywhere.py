"""Objects that nothing explains: a part of those said to leave may appear again, anywhere.

A departure that no hazard and no path explains need not be one of an object that leaves the site:
traffic may be too dense, or the transit times too spread, for a path to be found. So the question
is twofold:

* How many are too many? Of all objects that leave a view, about ``1 / (1 + cameras / 4)`` leave the
  site: the larger the site, the fewer of its paths lead out. The surplus over that share may
  appear again (`surplus`).
* Could it be known? Had these objects gone on by one path, the fit would have gained evidence from
  it, more at zones with many departures and in light traffic. Where it would have been found, and
  was not, it is not there, and the objects leave (`missed_shares`). The second opinion has narrow
  paths only, so what it does not find tells nothing.

Those that may appear again are shared among the other cameras by the arrivals there that no
departure explains, at any lag (`Anywhere`), and by what was declared of neighbours. On a site that
nobody leaves, all who are not found are shared out, most to cameras to which published links lead.
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats, Rows
from camtopod.predict.hazards import Hazards, model_of
from camtopod.records import Topology
from camtopod.topology import LEAVE_FLOOR, declared_odds

LEAVING_CAMERAS = 4.0
"""Number of cameras of a site at which half of all departures leave it."""
SURE_MAX = 0.95
"""Largest share of the departures without explanation that are taken to leave."""
SPREAD_STEPS = 8
"""Number of spreads of transit times, from a second to the longest lag, that a path may have."""
ERFC = (1.061405429, -1.453152027, 1.421413741, -0.284496736, 0.254829592, 0.0)
"""Coefficients of a polynomial of the complementary error function."""
LINKED_ODDS = 30.0
"""How much likelier objects that are not found have gone where a published link leads than
elsewhere, on a site that nobody leaves. It is more than for what is declared, as links were tested.
"""


class Anywhere:
    """What may appear anywhere, by a topology version.

    unknown (zones,): share of the objects said to leave from each zone that may appear again.
    nobody_leaves: True if all of them do.
    """

    def __init__(self, topology: Topology, hazards: Hazards) -> None:
        cameras = hazards.cameras
        self._camera_of = camera_of = hazards.camera_of
        rate = hazards.unexplained_rate
        self._arrival_rate = np.bincount(camera_of, rate, minlength=len(cameras))
        """(cameras, 1/s) rate of arrivals that no departure explains."""
        self.within_camera = rate / np.maximum(self._arrival_rate[camera_of], 1e-300)
        """(zones,) share of each zone in those of its camera."""
        declarations = model_of(topology).declared
        self.nobody_leaves = declarations is not None and declarations.nobody_leaves
        self._declared_odds = declared_odds(declarations, cameras)
        self.neighbours = _linked_cameras(topology, camera_of)
        """Cameras to which published links lead from each, by number of camera."""
        by_rate = np.argsort(rate, kind="stable")
        self.busiest = np.zeros(len(cameras), np.intp)
        """(cameras,) index of the zone of each camera with the most such arrivals."""
        self.busiest[camera_of[by_rate]] = by_rate

        # What leaves by each of the two opinions, and the part of both that is unknown.
        leave, by_paths, weight = hazards.leaving()
        departures = hazards.departures.astype(float)
        missed_share = missed_shares(departures * leave, leave, rate, hazards.bins.lag_max)
        first, second = (
            surplus(departures, absence, len(topology.cameras)) for absence in (leave, by_paths)
        )
        leave, by_paths = (1.0 - weight) * leave, weight * by_paths
        self.unknown = (leave * first * missed_share + by_paths * second) / (leave + by_paths)
        if self.nobody_leaves:
            self.unknown[:] = 1.0 - LEAVE_FLOOR

    def shares(self, zone: int) -> Floats:
        """Return the shares (cameras,) of those said to leave a zone that appear at each camera.

        zone: index of the zone.

        Arrivals that no departure explains weigh, times the odds of declared pairs. On a site that
        nobody leaves, published links count, and objects return unseen to the view that they have
        left; where objects leave, those that take a link have been found.
        """
        camera = int(self._camera_of[zone])
        odds = (
            np.ones(len(self._arrival_rate))
            if self._declared_odds is None
            else self._declared_odds[camera]
        )
        likely = self._arrival_rate * odds
        if self.nobody_leaves:
            neighbours = self.neighbours.get(camera, [])
            likely[neighbours] = self._arrival_rate[neighbours] * np.maximum(
                odds[neighbours], LINKED_ODDS
            )
        else:
            likely[camera] = 0.0
        shares: Floats = self.unknown[zone] * likely / max(float(likely.sum()), 1e-300)
        return shares


def _linked_cameras(topology: Topology, camera_of: Rows) -> dict[int, list[int]]:
    """Return the cameras to which published links lead from each, by number of camera."""
    camera = dict(zip((zone.id for zone in topology.zones), camera_of.tolist(), strict=True))
    neighbours: dict[int, list[int]] = {}
    for link in topology.links:
        if link.relation != "visible" and {link.from_, link.to} <= camera.keys():
            neighbours.setdefault(camera[link.from_], []).append(camera[link.to])
    return neighbours


def surplus(departures: Floats, leave: Floats, cameras: int) -> float:
    """Return the part of all departures said to leave that is too much for a site of this size.

    departures (zones,): number of departures of each zone.
    leave (zones,): share of them that is said to leave the site.
    cameras: number of cameras.
    """
    usual = float(departures.sum()) / (1.0 + cameras / LEAVING_CAMERAS)
    return 1.0 - min(usual / max(float(departures @ leave), 1e-9), SURE_MAX)


def missed_shares(absences: Floats, leave: Floats, rate: Floats, lag_max: float) -> Floats:
    """Return the probability (zones,) that a path of all that leave would not have been found.

    absences (zones,): number of departures of each zone that are said to leave.
    leave (zones,): share of them in all departures.
    rate (zones, 1/s): rate of arrivals at each zone that no departure explains.
    lag_max (seconds): longest lag.
    """
    # The evidence of such a path, by the spread of its transit times: each transition competes with
    # the arrivals of a usual zone within the spread.
    spread = np.geomspace(1.0, lag_max, SPREAD_STEPS)
    chance = spread * (rate @ rate) / max(float(rate.sum()), 1e-9)
    share = leave[:, None] / (leave[:, None] + np.maximum(chance, 1e-6))
    evidence = absences[:, None] * (-np.log1p(-share) - share)

    # The probability that it falls short of what tells a path from all others that are possible;
    # the variance of a log likelihood ratio is about twice its mean.
    threshold = np.log(max(len(rate), 1) * lag_max / spread)
    short = (threshold - evidence) / np.sqrt(2.0 * evidence + 1.0)
    shares: Floats = _normal_share(short).mean(axis=1)
    return shares


def _normal_share(z: Floats) -> Floats:
    """Return the standard normal distribution at ``z``, to 1e-7 (Abramowitz and Stegun 7.1.26)."""
    x = np.abs(z) / np.sqrt(2.0)
    above: Floats = 0.5 * np.polyval(ERFC, 1.0 / (1.0 + 0.3275911 * x)) * np.exp(-x * x)
    return np.where(z > 0.0, 1.0 - above, above)
