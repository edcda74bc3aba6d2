"""Joint EM over the paths of the dictionary.

Every arrival has one source, a departure by one of the paths or the outside, and every departure
one outcome, an arrival or nothing. The E step approximates the marginals of this assignment by
sum-product messages (Williams and Lau 2014), as the joint fit does (`association.em`), on the
candidates near a path only. The M step estimates shares, places, and widths, which shrink to the
usual width of paths on real sites.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import digamma

from camtopod.arrays import Floats, Longs, Rows, Singles
from camtopod.learn.association import (
    ITERATIONS,
    SWEEPS,
    ConvergenceMonitor,
    answers,
    claims,
    offers,
)
from camtopod.learn.lags import BIN_SECONDS
from camtopod.learn.links import (
    OUTSIDE_LEAST,
    PathEvidence,
    evidence_against_unrelated,
    expected_by_part,
    repeated_evidence,
)
from camtopod.learn.paths.camera_lags import CameraLags
from camtopod.learn.paths.dictionary import log_density
from camtopod.topology import DEGREES, LEAVE_FLOOR, REACH_WIDTHS, student_density

PATH_ITERATIONS = 15
"""Largest number of EM iterations of a run with all paths of the dictionary."""
SPARSE_NATS = (0.3, 0.6, 1.0, 1.5, 2.0, 2.5, 3.0)
"""Least evidence of a path in the rounds of the fit for links."""
WIDTH_PRIOR = (4.0, 3.0)
"""The usual width in seconds, and its weight in that of a path, in transitions."""


class Paths(NamedTuple):
    """K paths between cameras, ordered as the peaks that they began with."""

    pair: Longs
    """(K,) pair of cameras."""
    share: Floats
    """(K,) share of the departures at the first camera that take the path."""
    place: Floats
    """(K,) median lag, seconds."""
    width: Floats
    """(K,) scale of the lags, which have Student's t distribution with 5 degrees, seconds."""


class PathExpectation(NamedTuple):
    """Result of an E step: n candidates near any path, and e pairs of one and a path near it."""

    rows: Rows
    """(n,) the candidates."""
    responsibility: Floats
    """(n,) of all paths near each candidate together."""
    row: Rows
    """(e,) index in ``rows``."""
    path: Rows
    """(e,) the path."""
    part: Floats
    """(e,) its expected transitions."""


class PathFit:
    """The fit in progress.

    favour (cameras ** 2): factor on the rates of each pair of cameras.
    pair, place, width (K,): the peaks that it begins with (`find_peaks`).

    paths: the present estimate.
    outside (cameras,): share of the arrivals at each camera that come from outside.
    """

    def __init__(
        self, lags: CameraLags, favour: Singles, pair: Longs, place: Floats, width: Floats
    ) -> None:
        self.lags = lags
        self._favour = favour
        self.departures = np.bincount(lags.source, minlength=lags.cameras).astype(float)
        self.arrivals = np.bincount(lags.target, minlength=lags.cameras).astype(float)

        # Equal shares at first.
        paths_from = np.bincount(pair // lags.cameras, minlength=lags.cameras)
        share = 0.5 / np.maximum(paths_from, 5)[pair // lags.cameras]
        self.paths = Paths(pair, share, place, width)
        self.outside = np.ones(lags.cameras)
        self._demand = lags.rate
        self.monitor = ConvergenceMonitor()
        """Tells whether the newest run of iterations has converged."""

    def run(self, iterations_max: int = PATH_ITERATIONS) -> None:
        """Run EM."""
        self.monitor = ConvergenceMonitor(iterations_max)
        for _ in self.monitor:
            self.monitor.report(self._maximise(self._expect()))

    def evidence(self) -> PathEvidence:
        """Go on with fewer and fewer paths, and return the evidence for those that are left.

        Most peaks of the dictionary are no paths. Together, they take the arrivals of true ones.
        """
        for least in SPARSE_NATS:
            step = self._expect()
            mask = evidence_against_unrelated(step.path, step.part, len(self.paths.pair)) >= least
            pair, share, place, width = self.paths
            self.paths = Paths(pair[mask], share[mask], place[mask], width[mask])
            self.run(ITERATIONS)
        # The null model that judges links (`links.judging`).
        self.outside = np.maximum(self.outside, OUTSIDE_LEAST)
        self._favour = np.ones_like(self._favour)
        self.lags = self.lags._replace(rate=self.lags.active)
        step = self._expect()
        pair, _, place, width = self.paths
        lags, source = self.lags, self.paths.pair // self.lags.cameras
        departure_part = np.arange(len(lags.departure_t)) / max(len(lags.departure_t), 1)
        arrival_part = lags.arrival[step.rows[step.row]] / max(len(lags.target), 1)
        transitions = np.bincount(step.path, step.part, minlength=len(pair)).astype(float)
        expected = expected_by_part(
            transitions, source, lags.source.astype(np.int32), departure_part
        )
        nats = repeated_evidence(
            step.path, step.part, np.zeros(len(arrival_part)), arrival_part, len(pair), expected
        )

        # A path has been looked for at all places.
        nats = np.maximum(nats + log_density(place, width, self.lags.lag_max), 0.0)
        return PathEvidence(source, pair % lags.cameras, place, width, nats)

    def _maximise(self, step: PathExpectation) -> Floats:
        """Do the M step with the result of an E step; return the transitions of each path, (K,)."""
        lags, path, part = self.lags, step.path, step.part
        transitions: Floats = np.bincount(path, part, minlength=len(self.paths.pair)).astype(float)
        target = lags.target[lags.arrival[step.rows]]
        arrival_sums = np.bincount(target, step.responsibility, minlength=lags.cameras)
        self.outside = np.maximum(1.0 - arrival_sums / np.maximum(self.arrivals, 1.0), LEAVE_FLOOR)

        # Places and widths, then shares.
        place, width = self._moved(lags.lag[step.rows[step.row]], path, part, transitions)
        self.paths = Paths(self.paths.pair, self._shares(transitions), place, width)
        return transitions

    def _expect(self) -> PathExpectation:
        """Do the E step on the candidates near any path, which may be near several."""
        lags = self.lags
        pair, share, place, width = self.paths
        near = REACH_WIDTHS * width
        path, row, rows = lags.within(pair, place - near, place + near)
        lag = lags.lag[rows][row]
        rate = (share * self._favour[pair])[path] * student_density(lag, place[path], width[path])
        if lags.likeness is not None:
            rate *= lags.likeness[rows][row]
        total = np.bincount(row, rate, minlength=len(rows)).astype(float)
        responsibility = self._responsibility(rows, total)
        part = responsibility[row] * rate / np.maximum(total[row], 1e-300)
        return PathExpectation(rows, responsibility, row, path, part)

    def _responsibility(self, rows: Rows, rate: Floats) -> Floats:
        """Return the responsibility (n,) of candidates.

        rows (n,): the candidates.
        rate (n,): rate of each by all paths near it.
        """
        lags = self.lags
        departure, arrival = lags.departure[rows], lags.arrival[rows]
        source = self.paths.pair // lags.cameras
        path_share = np.bincount(source, self.paths.share, minlength=lags.cameras)
        no_path = np.maximum(1.0 - path_share, LEAVE_FLOOR)[lags.source]
        background = self.outside[lags.target] * lags.rate
        message = 1.0 / np.maximum(self._demand, background)[arrival]
        for _ in range(SWEEPS):
            claim_sums = claims(rate, message, departure, no_path)
            offer = offers(rate, message, departure, claim_sums)
            self._demand = background + np.bincount(arrival, offer, minlength=len(background))
            responsibility, message = answers(offer, self._demand[arrival])
        return responsibility

    def _moved(
        self, lag: Floats, path: Rows, part: Floats, transitions: Floats
    ) -> tuple[Floats, Floats]:
        """Return new places and widths (K,), by EM for Student's t (Lange and others 1989).

        lag, path, part (e,): lag, path and expected transitions of each candidate near a path.
        transitions (K,): expected transitions of each path.
        """
        _, _, place, width = self.paths

        def summed(values: Floats) -> Floats:
            """Return the sum of the values (e,) of each path, (K,)."""
            return np.bincount(path, values, minlength=len(place)).astype(float)

        # Far lags weigh less.
        weight = part * (DEGREES + 1) / (DEGREES + ((lag - place[path]) / width[path]) ** 2)
        mean_lag = (summed(weight * lag) + 1e-3 * place) / (summed(weight) + 1e-3)
        squares = summed(weight * (lag - mean_lag[path]) ** 2)
        usual, prior = WIDTH_PRIOR
        spread = np.sqrt((squares + prior * usual**2) / (transitions + prior))
        return mean_lag, np.maximum(spread, BIN_SECONDS)

    def _shares(self, transitions: Floats) -> Floats:
        """Return the shares (K,) of the departures that take each path.

        They are geometric means of the posterior under a uniform prior, which prefers few paths.
        """
        cameras = self.lags.cameras
        source = self.paths.pair // cameras
        of = np.bincount(source, minlength=cameras)
        share = np.exp(digamma(transitions + 1.0) - digamma(self.departures + 1.0 + of)[source])
        total = np.bincount(source, share, minlength=cameras)
        result: Floats = share / np.maximum(total / (1.0 - LEAVE_FLOOR), 1.0)[source]
        return result
