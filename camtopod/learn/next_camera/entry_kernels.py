"""Entry kernels: where views overlap, the time from entering one view to appearing in the next.

An object that appears in an overlapping view before it leaves this one (a candidate with a negative
lag) often does so a certain time after it *entered* this view. The *entry kernel* of a zone of
entry and a zone of the next appearance is the rate of appearing by time from the entry. In the
EM fit (`association.em`), `EntryKernels` estimates the kernels and gives candidates their rates.

There may be twenty thousand pairs of an entry zone and a zone of the next appearance, nearly all of
them spurious. Only the values at the candidates are kept: a table of all kernels would take more
memory than the rest of a fit.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Indices, Singles, row_slices
from camtopod.learn.association import START_FLOOR, Candidates, Problem, initial_hazards
from camtopod.learn.limits import ENTRY_PAIRS_MAX, of_site
from camtopod.learn.links import passages_lasting
from camtopod.learn.traffic import NullRates
from camtopod.topology import smooth


class EntryKernels:
    """The entry kernels of Q pairs of zones, and the m candidates that they give rates to.

    The pairs are of a zone of entry and a zone of the next appearance in another view. The
    candidates are those with a negative lag whose departure ends a passage of known entry.
    """

    def __init__(
        self,
        problem: Problem,
        candidates: Candidates,
        entry: NDArray[np.int64],
    ) -> None:
        """Select the candidates and number the pairs of zones.

        candidates: all candidates of the fit.
        entry (n,): zone where the passage of each departure began, -1 where unknown.
        """
        c = candidates
        d, a, bins, zones, *_ = problem
        self._arrivals = a
        self._bins = bins
        self._zones = zones

        # Candidates with a negative lag, and their lag from the entry.
        has_entry = (d.own >= 0) & np.isfinite(d.since)
        early = np.flatnonzero((c.lag < 0) & has_entry[c.departure])
        at = bins.index(a.t[c.arrival[early]] - d.since[c.departure[early]])
        early = early[at >= 0]
        at = at[at >= 0]

        # Pairs of zones; beyond the limit, the rarest have no kernel, so that their candidates only
        # have rates by lag from the exit.
        key = entry[c.departure[early]] * zones + a.zone[c.arrival[early]]
        present, number, often = np.unique(key, return_inverse=True, return_counts=True)
        cameras = int(a.camera.max(initial=0)) + 1
        pairs_max = of_site(ENTRY_PAIRS_MAX, cameras)
        if len(present) > pairs_max:
            usual = np.sort(np.argsort(-often, kind="stable")[:pairs_max])
            mask = np.isin(number, usual)
            early = early[mask]
            at = at[mask]
            number = np.searchsorted(usual, number[mask])
            present = present[usual]

        self.rows: Indices = early
        """(m,) rows of these candidates, ascending."""
        self.source = (present // max(zones, 1)).astype(np.int32)
        """(Q,) zone of entry of each pair."""
        self.target = (present % max(zones, 1)).astype(np.int32)
        """(Q,) zone of the next appearance of each pair."""
        self.cell = number.astype(np.int64) * bins.size + at
        """(m,) index of each candidate in a flattened table of kernels (Q, bins)."""
        self.hazard, self.own_share, self.share = np.zeros((3, len(early)))
        """(m,) each. ``hazard``: value of the kernel at the candidate, per second. ``own``: share
        of that value that the candidate contributes itself if its weight is 1, for leave-one-out.
        ``share``: share of the candidate's rate that the kernel contributes.
        """
        self._order = np.argsort(self.cell, kind="stable")
        self._cell_in_order = self.cell[self._order]
        self._entry_t = d.since[has_entry]
        self._entry_zone = entry[has_entry]
        self.exposure = passages_lasting((d.t - d.since)[has_entry], self._entry_zone, bins, zones)
        """(zones, bins) number of passages from each zone of entry that are still in view when a
        bin of the time from the entry begins.
        """

    def start(self, noise_sd: float) -> None:
        """Set the first kernels: the excess over the null model.

        noise_sd: standard deviations of the null model that are subtracted in addition.
        """
        a = self._arrivals
        if len(self.rows) == 0:
            return
        rates = NullRates(
            self._entry_t, self._entry_zone.astype(np.int32), a.t, a.zone, self._zones
        )
        for rows, members, counts in self._counts(np.ones(len(self.rows))):
            source = self.source[rows]
            chance = rates.rates_of(source, self.target[rows])
            first = initial_hazards(
                counts, chance, self.exposure, source, self._bins, noise_sd, START_FLOOR
            )
            self.hazard[members] = first.take(self.cell[members] - rows.start * self._bins.size)

    def rates(self, responsibility: Singles) -> Floats:
        """Return the values (m,) of the kernels at the candidates, each as the others make it.

        responsibility (m,): of these candidates.
        """
        other_share: Floats = np.maximum(1.0 - responsibility * self.own_share, 0.0)
        return self.hazard * other_share

    def learn(self, responsibility: Singles) -> None:
        """Do the M step: estimate the kernels by the responsibilities (M,) of all candidates."""
        for rows, members, counts in self._counts(self._weight(responsibility)):
            cell = self.cell[members] - rows.start * self._bins.size
            smooth_counts, own_share = smooth(counts)
            self.own_share[members] = own_share.take(cell // self._bins.size) / np.maximum(
                smooth_counts.take(cell), 1e-300
            )
            self.hazard[members] = (smooth_counts / self._exposed(rows)).take(cell)

    def kernels(self, responsibility: Singles) -> Floats:
        """Return the kernels (Q, bins) by time from the entry, per second and passage in view.

        responsibility (M,): of all candidates.
        """
        counts_of_parts = self._counts(self._weight(responsibility))
        kernels = [smooth(counts)[0] / self._exposed(rows) for rows, _, counts in counts_of_parts]
        return np.concatenate([np.zeros((0, self._bins.size)), *kernels])

    def _weight(self, responsibility: Singles) -> Floats:
        """Return the weight (m,) of each candidate in the count of its kernel.

        responsibility (M,): of all candidates.
        """
        weight: Floats = responsibility[self.rows] * self.share
        return weight

    def _counts(self, weight: Floats) -> Iterator[tuple[slice, NDArray[np.intp], Floats]]:
        """Yield the weights of candidates summed by pair of zones and bin, some pairs at a time.

        weight (m,): weight of each candidate.

        Each item is a slice of the pairs; the indices of their candidates in `rows`; and the sums
        (pairs of the slice, bins).
        """
        size = self._bins.size
        for rows in row_slices(len(self.source)):
            first, last = np.searchsorted(
                self._cell_in_order, (rows.start * size, rows.stop * size)
            ).tolist()
            members = self._order[first:last]
            cell = self._cell_in_order[first:last] - rows.start * size
            counts = np.bincount(cell, weight[members], minlength=(rows.stop - rows.start) * size)
            yield rows, members, counts.astype(float, copy=False).reshape(-1, size)

    def _exposed(self, rows: slice) -> Floats:
        """Return the exposure (pairs, bins) of some pairs: passages in view times seconds."""
        departure_seconds: Floats = (
            np.maximum(self.exposure[self.source[rows]], 1.0) * self._bins.widths
        )
        return departure_seconds
