"""What a fit by EM assumes in addition to hazards and background (`em.Em`)."""

from __future__ import annotations

from collections.abc import Callable
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


class Expected(Protocol):
    """Transitions that a prior adds to the counted ones, as if there were more departures.

    departures: number of additional departures of each zone.
    """

    departures: float

    def of(self, rows: slice, rates: Callable[[Longs], Floats]) -> Floats:
        """Return the transitions (pairs, bins) that the prior adds to the pairs of zones ``rows``.

        rates: function from pairs (k,) to the counted transitions per exposed departure (k, bins).
        """


class PairPrior(Protocol):
    """A prior over the transitions of pairs of zones, such as `next_camera.prior.Prior`."""

    def expected(self, counts: Floats) -> Expected:
        """Return what the prior adds, given the counted transitions ``counts`` (P, bins)."""


class EmModel(NamedTuple):
    """The additions of one fit, none by default; `Em.assume` replaces them as the fit goes on."""

    entering: Beside | None = None
    """Rates by the time since the entry, in overlapping views (`next_camera.entry_kernels`)."""
    prior: PairPrior | None = None
    """Prior over the transitions of pairs of zones."""
    sparsity: float = 0.0
    """Transitions that a sparse prior (a Gamma with shape 0) takes off each pair of zones."""
    multiplier: Singles | None = None
    """(M,) factor on each candidate's rate, by the context of its departure; None for 1."""
    leaving: Floats | None = None
    """(n,) probability that the object of each departure leaves the site; None to compute it from
    the hazards.
    """
    near: Bools | slice = slice(None)
    """(n,) mask of departures that the null model of the first hazards counts."""


NO_ADDITIONS = EmModel()
