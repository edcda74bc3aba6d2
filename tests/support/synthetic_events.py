"""Synthetic data for tests: a topology equal to the ground truth; passages through views."""

import numpy as np

from camtopod.learn.association.candidates import Candidates, find_candidates
from camtopod.learn.association.problem import Problem
from camtopod.learn.learner import Learner
from camtopod.learn.next_camera.fit import Posterior, fit_window
from camtopod.learn.next_camera.spurious import spurious_shares
from camtopod.learn.traffic.background_rate import local_rates
from camtopod.learn.traffic.events import Arrivals, Departures
from camtopod.records import TOPOLOGY_SCHEMA, Camera, Event, Link, Topology, Zone
from camtopod.sim.truth import Truth
from camtopod.topology.lag_bins import LagBins


def topology_of(truth: Truth) -> Topology:
    """Return the topology that a learner with all identities would publish."""
    zones = [
        Zone(id=z.id, camera=z.camera, entries=100, exits=100, x=z.x, y=z.y, cov=z.cov)
        for z in truth.zones
    ]
    links = [
        Link(
            from_=link.from_,
            to=link.to,
            relation=link.relation,
            probability=link.probability,
            transitions=100 * link.probability,
            transit=link.transit,
            q_value=0.0,
            mahalanobis_variance=0.5,
        )
        for link in truth.links
        if link.transitions > 0
    ]
    cameras = [Camera(id=c, zones=[z.id for z in zones if z.camera == c]) for c in truth.cameras]
    return Topology(
        schema=TOPOLOGY_SCHEMA,
        site="made",
        epoch="01J",
        version=3,
        as_of=1_700_003_600.0,
        events=4000,
        digest="sha256:0",
        cameras=cameras,
        zones=zones,
        links=links,
        pairs=truth.pairs,
    )


def passage(camera: str, entered: float, stay: float, track: str) -> list[Event]:
    """Return entry and exit of an object that is in view for ``stay`` seconds."""
    return [
        Event(camera, "entry", entered, track=track),
        Event(camera, "exit", entered + stay, track=track),
    ]


def learned_from(events: list[Event]) -> Topology:
    """Return the one version that `camtopod learn` makes of a recording."""
    learner = Learner(only_last=True)
    for event in events:
        learner.receive(event)
    learner.flush()
    assert learner.topology is not None
    return learner.topology


class Views:
    """Passages of objects through views, as input of a fit.

    ``camera`` is that of each zone; tracks tie every exit to its entry.
    """

    def __init__(self, camera: list[int]) -> None:
        self.camera = np.array(camera, np.int32)
        self.rows: list[tuple[float, float, int, int, int]] = []

    def through(self, entered: float, left: float, entry: int, leave: int, block: int = -1) -> None:
        """Add a passage from zone ``entry`` to zone ``leave``; ``block`` is the image block at its
        end.
        """
        self.rows.append((entered, left, entry, leave, block))

    def columns(self) -> tuple[Departures, Arrivals]:
        """Return departures and arrivals, each by time."""
        since, t, entry, leave, block = (
            np.array(column) for column in zip(*self.rows, strict=True)
        )
        entry, leave, block = (column.astype(np.int32) for column in (entry, leave, block))
        came, left = np.argsort(since, kind="stable"), np.argsort(t, kind="stable")
        place = np.empty(len(t), np.int32)
        place[came] = np.arange(len(t))
        unknown = np.full(len(t), np.nan)
        rate = local_rates(since[came], entry[came], len(self.camera))
        return (
            Departures(
                t[left],
                leave[left],
                self.camera[leave[left]],
                since[left],
                unknown,
                place[left],
                block[left],
            ),
            Arrivals(since[came], entry[came], self.camera[entry[came]], rate, unknown),
        )

    def problem(self, bins: LagBins) -> Problem:
        departures, arrivals = self.columns()
        until = float(max(departures.t[-1], arrivals.t[-1]))
        return Problem(departures, arrivals, bins, len(self.camera), until)


def fit_posterior(problem: Problem, candidates: Candidates | None = None) -> Posterior:
    """Return the posterior of some candidates of a problem, or all, on a site that has links."""
    cameras = 1 + max(int(ends.camera.max(initial=0)) for ends in problem[:2])
    apart = np.zeros((cameras, cameras), np.bool_)
    posterior, _ = fit_window(problem, candidates or find_candidates(problem), apart)
    c = posterior.fit.candidates
    no_evidence = np.zeros(len(c.source))
    views = problem.cameras()
    doubt = spurious_shares(
        c.pair, posterior.fit.responsibility, no_evidence, 1.0, views[c.source] == views[c.target]
    )
    return posterior._replace(doubt=doubt)
