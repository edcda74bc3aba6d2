"""Screening: select the candidates for the joint fit on sites with too many candidates for one fit.

On a large site some zones of departure are *followed* as sources of each zone of arrival:

* *A look at new zones* (`CandidateScreen.find`) counts their arrivals after the departures from
  every zone, in wide lag bins, and compares the counts with the null model (Makris, Ellis and Black
  2004). The zones that stand out most are followed.
* *Weighing, in every fit.* Candidates along the followed pairs of zones are weighed by the excess
  over the null model. Improbable candidates are dropped.
* *A look at what a fit leaves unexplained* (`CandidateScreen.look_again`). Objects that pass zone
  after zone make every two of these stand out, and so hide links of little traffic. Once a fit has
  told which departures and arrivals belong together, the zones are compared without these. The
  sources that the fit has confirmed are followed further, and those that stand out now. Each fit
  looks at a share of the zones of arrival, those with the oldest look first.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TypeVar

import numpy as np
from msgspec import Struct

from camtopod.arrays import Longs, Rows, find_rows
from camtopod.learn.association.candidates import (
    Candidates,
    departures_in_reach,
    find_candidates,
    number_pairs,
)
from camtopod.learn.association.joint_fit import Fit
from camtopod.learn.association.problem import Problem
from camtopod.learn.association.traffic_excess import Traffic
from camtopod.learn.association.weighing import ZonePairs, joined, likely
from camtopod.learn.limits import WEIGHED_MAX

PAIRS_FEW = 20_000
"""Number of pairs of zones up to which candidates are not screened, unless they are too many."""
LOOK_SHARE = 0.125
"""Share of the zones of arrival that are looked at again after each fit."""
ZONES_AT_ONCE = 64
"""Zones of arrival that are looked at together."""
SOURCES_MAX = 32
"""Largest number of zones of departure that are followed for a new zone of arrival."""
UNCONFIRMED_SOURCES_MAX = 16
"""Largest number of those that are followed, beside confirmed ones, after a look at the rest."""
EXPLAINED_MIN = 0.5
"""Probability from which a departure or an arrival is explained by a fit."""


class FollowedSources(Struct):
    """The zones of departure that are followed as sources of one zone of arrival."""

    sources: Longs
    """Keys (`place`) of these zones of departure."""
    looked: int
    """Number of events learned at the last look at the zone of arrival; -1 if there was none."""


class CandidateScreen:
    """Selects the candidates of each fit, and remembers which pairs of zones are followed.

    On a small site, `find` returns all candidates, and no pair is remembered.
    """

    def __init__(self, sources_by_place: Mapping[int, FollowedSources] | None = None) -> None:
        self.sources_by_place = dict(sources_by_place or {})
        """Zones of departure that are followed, by key (`place`) of the zone of arrival."""

    @staticmethod
    def is_needed(problem: Problem, candidates_max: int) -> bool:
        """Return True if there are too many candidates or pairs of zones for one fit.

        candidates_max: limit of the candidates; that of the pairs is `PAIRS_FEW`.
        """
        low, high = departures_in_reach(problem.departures.t, problem.arrivals.t, problem.bins)
        return int((high - low).sum()) > candidates_max or problem.zones**2 > PAIRS_FEW

    def find(
        self, problem: Problem, places: Longs, events_learned: int, candidates_max: int
    ) -> Candidates:
        """Return the candidates of a window, screened if there are too many.

        places (zones,): key of each zone that stays the same from fit to fit (`place`).
        events_learned: number of events learned so far.
        candidates_max: number of candidates up to which all are returned.
        """
        if not self.is_needed(problem, candidates_max):
            self.sources_by_place = {}
            return find_candidates(problem)

        # Forget zones that exist no more; look at new ones.
        never = FollowedSources(np.zeros(0, np.int64), -1)
        self.sources_by_place = {p: self.sources_by_place.get(p, never) for p in places.tolist()}
        new = np.flatnonzero(self._last_looks() < 0)
        traffic = Traffic(problem)
        for zone, sources in _outstanding(traffic, new, SOURCES_MAX):
            record = FollowedSources(places[sources], events_learned)
            self.sources_by_place[int(places[zone])] = record

        pairs = ZonePairs(problem, *self._pairs(places))
        blocks = pairs.blocks(WEIGHED_MAX)
        departure, arrival, pair, lag = joined(likely(traffic, pairs, block) for block in blocks)

        # Number the pairs of zones that are left.
        pair, source, target = number_pairs(pairs.source[pair], pairs.target[pair], problem.zones)
        return Candidates(departure, arrival, pair, lag, source, target)

    def look_again(
        self,
        problem: Problem,
        fit: Fit,
        places: Longs,
        events_learned: int,
        everywhere: bool = False,
    ) -> bool:
        """Look at zones of arrival with what a fit leaves unexplained, for the fit after it.

        Return False on a small site, or if nothing is left.

        problem, places, events_learned: as given to `find`.
        fit: the fit of its candidates.
        everywhere: True to look at every zone now, as there is one more fit only.
        """
        if not self.sources_by_place:
            return False
        rest = unexplained(problem, fit)
        if not (len(rest.departures.t) and len(rest.arrivals.t)):
            return False
        share = int(np.ceil((1.0 if everywhere else LOOK_SHARE) * len(places)))
        targets = np.argsort(self._last_looks(), kind="stable")[:share]
        confirmed = fit.candidates
        for zone, sources in _outstanding(Traffic(rest), targets, UNCONFIRMED_SOURCES_MAX):
            followed = np.union1d(confirmed.source[confirmed.target == zone], sources)
            record = FollowedSources(places[followed], events_learned)
            self.sources_by_place[int(places[zone])] = record
        return True

    def _last_looks(self) -> Rows:
        """Return the number of events at the last look at each zone of arrival, (zones,)."""
        return np.array([record.looked for record in self.sources_by_place.values()], np.intp)

    def _pairs(self, places: Longs) -> tuple[Rows, Rows]:
        """Return the sources and the targets of the followed pairs of zones, by target."""
        source_lists = [record.sources for record in self.sources_by_place.values()]
        target = np.repeat(np.arange(len(places)), [len(sources) for sources in source_lists])
        source, exists = find_rows(places, np.concatenate(source_lists))
        return source[exists], target[exists]


def unexplained(problem: Problem, fit: Fit) -> Problem:
    """Return a problem with the departures and the arrivals that a fit does not explain."""
    departures, arrivals, candidates = problem.departures, problem.arrivals, fit.candidates
    effect = np.bincount(candidates.departure, fit.responsibility, len(departures.t))
    cause = np.bincount(candidates.arrival, fit.responsibility, len(arrivals.t))
    has_no_effect, has_no_cause = effect < EXPLAINED_MIN, cause < EXPLAINED_MIN
    return problem._replace(
        departures=departures.take(has_no_effect, has_no_cause),
        arrivals=arrivals.take(has_no_cause),
    )


def _outstanding(traffic: Traffic, targets: Rows, sources_max: int) -> Iterator[tuple[int, Rows]]:
    """Yield each zone of arrival with the zones of departure that stand out most, ascending.

    targets (k,): the zones of arrival.
    sources_max: largest number of zones of departure for each.
    """
    for at_once in np.split(targets, range(ZONES_AT_ONCE, len(targets), ZONES_AT_ONCE)):
        above = traffic.excess(at_once)
        source_count = min(sources_max, len(above))
        best = np.sort(np.argpartition(above, -source_count, axis=0)[-source_count:], axis=0)
        for target, sources, excess in zip(at_once.tolist(), best.T, above.T, strict=True):
            yield target, sources[excess[sources] > 0]


Place = TypeVar("Place", int, Longs)


def place(camera: Place, number: Place) -> Place:
    """Return the key of a zone, or of n zones, which stays the same from one fit to the next.

    camera: index of the camera.
    number: number of the zone among the camera's zones.
    """
    return (camera << 32) + number
