"""Measure how much the events determine: does a sampler that starts at the truth stay there?

    python -m bench limits [--regimes road,walkway] [--seeds N] [--sweeps 15,100,400] [--jobs 2]

One fit on the first 70 % of each network, predictions on the rest, relative to an oracle (a chain
that is given the identities):

* ``learned``: the learner as shipped;
* ``told``: the same tables and predictor, given the true destination of every departure; the limit
  of the method if all transitions were known;
* ``from the truth, N sweeps``: the learner's sampler of transitions, started at the truth and free
  from then on; it would stay near the truth if the truth were the best explanation of the events;
* ``from the fit, N sweeps``: the same sampler, started as the learner starts it.

Where the last two meet, a better search does not help, only other assumptions or more events do.
``on the truth`` is the mean responsibility of the true transitions among the candidates.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from bench.regimes import REGIMES
from bench.support.jobs import map_tasks
from bench.support.measure import TRAIN_SHARE, predict, prediction_figures
from camtopod.arrays import Floats, Singles
from camtopod.learn.association import Em
from camtopod.learn.learner import Learner
from camtopod.learn.next_camera import fit
from camtopod.learn.next_camera.fit import PosteriorFitter
from camtopod.learn.settings import Settings
from camtopod.records import Event
from camtopod.sim.scoring import next_entries
from camtopod.sim.truth import Truth

FIGURES = {
    "top1_ratio": "top-1",
    "top3_ratio": "top-3",
    "log_loss_above": "log loss above",
    "kept": "on the truth",
}
"""Figures of the table and their titles."""
MICROSECONDS = 1_000_000


class Told:
    """Ground truth of a recording, in the form of the fitter's candidates."""

    def __init__(self, events: Sequence[Event], truth: Truth) -> None:
        following = next_entries(events, truth)
        self.next = {
            round(event.t * MICROSECONDS): round(events[following[index]].t * MICROSECONDS)
            for index, event in enumerate(events)
            if event.kind == "exit" and following[index] >= 0
        }
        self.kept = float("nan")

    def responsibilities(self, em: Em) -> Singles:
        """Return 1 for each candidate (M,) that is a transition of one object, else 0."""
        c = em.candidates
        left, came = (
            np.rint(t * MICROSECONDS).astype(np.int64).tolist()
            for t in (em.problem.departures.t, em.problem.arrivals.t)
        )
        pairs = zip(c.departure.tolist(), c.arrival.tolist(), strict=True)
        return np.array([self.next.get(left[d]) == came[a] for d, a in pairs], np.float32)

    @contextmanager
    def at_every_step(self) -> Iterator[None]:
        """Set responsibilities to the truth while the block runs; nothing is sampled."""
        of = self.responsibilities

        class Told(Em):
            """EM whose E step sets the responsibilities to the truth."""

            def expect(self, hazard: Singles) -> None:
                super().expect(hazard)
                self.responsibility = of(self)

        with (
            patch.object(fit, "Em", Told),
            patch.object(PosteriorFitter, "sample", lambda _: None),
        ):
            yield

    @contextmanager
    def sampling(self, sweeps: int, from_truth: bool) -> Iterator[None]:
        """Sample ``sweeps`` sweeps while the block runs, starting at the truth or at the fit.

        The second half of the sweeps counts. True candidates are always worth following.
        """
        sample, worth = PosteriorFitter.sample, PosteriorFitter.worth_following

        def begin(fitter: PosteriorFitter) -> None:
            if from_truth:
                fitter.em.believe(self.responsibilities(fitter.em))
            sample(fitter)

        def follow(fitter: PosteriorFitter, overlapping: NDArray[np.bool_]) -> NDArray[np.bool_]:
            em = fitter.em
            em.believe(np.maximum(em.responsibility, self.responsibilities(em)))
            return worth(fitter, overlapping)

        with (
            patch.multiple(fit, SWEEPS_MIN=sweeps, SWEEPS_MAX=sweeps, SAMPLES_SHARE=1.0),
            patch.object(PosteriorFitter, "sample", begin),
            patch.object(PosteriorFitter, "worth_following", follow),
        ):
            yield

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Store the mean responsibility of true transitions in ``kept`` while the block runs."""
        posterior = PosteriorFitter.posterior

        def watched(fitter: PosteriorFitter, evidence: Floats) -> fit.Posterior:
            true = self.responsibilities(fitter.em)
            self.kept = float(fitter.em.responsibility @ true / max(true.sum(), 1.0))
            return posterior(fitter, evidence)

        with patch.object(PosteriorFitter, "posterior", watched):
            yield


def measure(regime: str, sweeps: Sequence[int], seed: int) -> dict[str, dict[str, float]]:
    """Return the figures of one network for each way of learning it."""
    events, truth = REGIMES[regime].make(seed)
    told = Told(events, truth)

    def figures() -> dict[str, float]:
        learner = Learner(Settings(refit_share=1e9, refit_hours=1e9))
        with told.watching():
            for event in events[: int(TRAIN_SHARE * len(events))]:
                learner.receive(event)
            learner.flush()
        assert learner.topology is not None
        return prediction_figures(predict(learner.topology, events), events, truth) | {
            "kept": told.kept
        }

    rows = {"learned": figures()}
    with told.at_every_step():
        rows["told"] = figures()
    for name, from_truth in (("from the truth", True), ("from the fit", False)):
        for n in sweeps:
            with told.sampling(n, from_truth):
                rows[f"{name}, {n} sweeps"] = figures()
    return rows


def main(argv: list[str]) -> int:
    """Measure, print the table and return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m bench limits")
    parser.add_argument("--regimes", default="road,walkway")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--sweeps", default="15,100,400")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default 2)")
    arguments = parser.parse_args(argv)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    sweeps = [int(n) for n in arguments.sweeps.split(",")]
    print(f"{'':36}" + "".join(f"{title:>22}" for title in FIGURES.values()))
    for regime in arguments.regimes.split(","):
        found = map_tasks(partial(measure, regime, sweeps), range(arguments.seeds), arguments.jobs)
        for row in found[0]:
            cells = []
            for figure in FIGURES:
                values = [one[row][figure] for one in found]
                error = np.std(values) / max(len(values) - 1, 1) ** 0.5
                cells.append(f"{np.mean(values):.3f} +- {error:.3f}".rjust(22))
            print(f"{regime}: {row}".ljust(36) + "".join(cells), flush=True)
    return 0
