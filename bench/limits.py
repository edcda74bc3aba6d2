"""How much the events can say of who came from where: does a search that begins at the truth stay
there?

    python -m bench limits [--regimes road,walkway] [--seeds N] [--sweeps 15,100,400] [--jobs 2]

One fit on the first 70 % of each network, predictions on the rest, as shares of a chain that is
told who is who:

* ``learned``: what the product says;
* ``told``: the same tables and the same predictor, told for every departure where it went. It is what the product would
  reach if nothing had to be guessed;
* ``from the truth, N sweeps``: the product's sampler of who came from where, told everything before its first draw and
  nothing afterwards. Were the truth the best explanation of the events it would stay near it;
* ``from the fit, N sweeps``: the same sampler as the product starts it.

Where the last two come to meet, no better search would help: only other assumptions, or more
events. ``on the truth`` is the share of the true transitions in the recording that is believed.
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
from bench.support.jobs import done
from bench.support.measure import TRAIN_SHARE, predict, prediction_figures
from camtopod.arrays import Floats, Singles
from camtopod.learn.association import Em
from camtopod.learn.learner import Learner
from camtopod.learn.next_camera import fit
from camtopod.learn.next_camera.fit import PosteriorFitter
from camtopod.learn.settings import Settings
from camtopod.records import Event
from camtopod.sim.score import next_entries
from camtopod.sim.truth import Truth

FIGURES = {
    "top1_ratio": "top-1",
    "top3_ratio": "top-3",
    "log_loss_above": "log loss above",
    "kept": "on the truth",
}
MICROSECONDS = 1_000_000


class Told:
    """The truth of a recording, as the fitter's candidates have it."""

    def __init__(self, events: Sequence[Event], truth: Truth) -> None:
        following = next_entries(events, truth)
        self.next = {
            round(event.t * MICROSECONDS): round(events[following[index]].t * MICROSECONDS)
            for index, event in enumerate(events)
            if event.kind == "exit" and following[index] >= 0
        }
        self.kept = float("nan")

    def of(self, em: Em) -> Singles:
        """1 for each candidate (M,) that is one object's next appearance, else 0."""
        c = em.candidates
        left, came = (
            np.rint(t * MICROSECONDS).astype(np.int64).tolist()
            for t in (em.departures.t, em.arrivals.t)
        )
        pairs = zip(c.departure.tolist(), c.arrival.tolist(), strict=True)
        return np.array([self.next.get(left[d]) == came[a] for d, a in pairs], np.float32)

    @contextmanager
    def at_every_step(self) -> Iterator[None]:
        """Nothing is guessed."""
        of = self.of

        class Told(Em):
            """EM whose E step knows the truth."""

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
        """Only the second half of so many sweeps counts."""
        sample, worth = PosteriorFitter.sample, PosteriorFitter.worth_following

        def begin(fitter: PosteriorFitter) -> None:
            if from_truth:
                fitter.em.responsibility = self.of(fitter.em)
            sample(fitter)

        def follow(fitter: PosteriorFitter, overlapping: NDArray[np.bool_]) -> NDArray[np.bool_]:
            em = fitter.em
            em.responsibility = np.maximum(em.responsibility, self.of(em))
            return worth(fitter, overlapping)

        with (
            patch.multiple(fit, SWEEPS_MIN=sweeps, SWEEPS_MAX=sweeps, SAMPLES_SHARE=1.0),
            patch.object(PosteriorFitter, "sample", begin),
            patch.object(PosteriorFitter, "worth_following", follow),
        ):
            yield

    @contextmanager
    def watching(self) -> Iterator[None]:
        """What is believed of the truth is written down."""
        posterior = PosteriorFitter.posterior

        def watched(fitter: PosteriorFitter, evidence: Floats) -> fit.Posterior:
            true = self.of(fitter.em)
            self.kept = float(fitter.em.responsibility @ true / max(true.sum(), 1.0))
            return posterior(fitter, evidence)

        with patch.object(PosteriorFitter, "posterior", watched):
            yield


def measure(regime: str, sweeps: Sequence[int], seed: int) -> dict[str, dict[str, float]]:
    """Figures of every way to learn one network."""
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
    """Measure and print the table; returns the exit status."""
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
        found = done(partial(measure, regime, sweeps), range(arguments.seeds), arguments.jobs)
        for row in found[0]:
            cells = []
            for figure in FIGURES:
                values = [one[row][figure] for one in found]
                error = np.std(values) / max(len(values) - 1, 1) ** 0.5
                cells.append(f"{np.mean(values):.3f} +- {error:.3f}".rjust(22))
            print(f"{regime}: {row}".ljust(36) + "".join(cells), flush=True)
    return 0
