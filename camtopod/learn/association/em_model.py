"""What a fit by EM assumes in addition to hazards and background (`em.Em`)."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from camtopod.arrays import Bools, Floats, Indices, Longs, Singles


class Beside(Protocol):
    """A further way in which some departures cause arrivals, beside the hazards by lag.

    The rate of a candidate is the hazard of its pair of zones plus this rate, where it applies.
    """

    rows: Indices
    """(m,) rows of the candidates that it applies to, ascending."""

    share: Floats
    """(m,) share of each of these candidates' rate that it contributes."""

    def rates(self, responsibility: Singles) -> Floats:
        """Return the rates (m,), 1/s, that its candidates get from it.

        responsibility (m,): of these candidates; the rate of each candidate must not depend on its
            own responsibility (leave one out).
        """

    def learn(self, responsibility: Singles) -> None:
        """Do the M step, with the responsibilities (M,) of all candidates."""


class PairPrior(Protocol):
    """A prior over the transitions of pairs of zones (`next_camera.prior.Prior`).

    Some more departures of each zone are taken to go where arrivals come from.
    """

    back: Longs
    """(P,) pair from each pair's target to its source; -1 if there is none."""

    def departures(self, transitions: Floats) -> float:
        """Return how many more departures of each zone, given ``transitions`` (P,) of each pair."""


class EmModel(NamedTuple):
    """The additions of one fit, none by default; `Em.model` is replaced as the fit goes on."""

    kernels: Beside | None = None
    """Rates by the time since the entry, in overlapping views (`next_camera.entry_kernels`)."""
    prior: PairPrior | None = None
    """Prior over the transitions of pairs of zones."""
    sparsity: float = 0.0
    """Transitions that a sparse prior (a Gamma with shape 0) takes off each pair of zones."""
    multiplier: Singles | None = None
    """(M,) factor on each candidate's rate, by the context of its departure; None for 1."""
    leave: Floats | None = None
    """(n,) probability that the object of each departure leaves the site; None to compute it from
    the hazards.
    """
    near: Bools | slice = slice(None)
    """(n,) mask of departures that the null model of the first hazards counts."""


NO_ADDITIONS = EmModel()
