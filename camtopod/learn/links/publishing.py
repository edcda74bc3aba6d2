"""The rule by which pairs of zones are published as links, clause by clause (METHOD 7).

`PublishingRule.judge` says which clauses each pair of a table meets. A *weak* link is likely but
not published; `PublishingRule.shortfall` estimates how many more objects must take it until it is.
The rule asks for a certain evidence (`significance`), and each further object is taken to add as
much as the earlier ones did on average. The evidence that counts is held-out (`cross_validation`).
It starts late, as a link has to be learned before it can predict anything, so the evidence per
object is estimated from the fit instead.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camtopod.arrays import Bools, Floats
from camtopod.learn.links.link_table import TRANSITIONS_MIN, LinkTable
from camtopod.learn.links.mahalanobis import LINKED_VARIANCE_MAX
from camtopod.learn.links.missed_detections import (
    MissedTransitions,
    Views,
    missed_transitions,
    own_transitions,
)
from camtopod.learn.links.significance import ratio_needed
from camtopod.learn.settings import Settings


class Verdict(NamedTuple):
    """Clauses of the rule that P pairs of zones meet; columns are (P,)."""

    q: Bools
    """The false discovery rate is small."""
    probability: Bools
    """Of the objects that leave the first zone, enough take it."""
    transitions: Bools
    """There are enough transitions."""
    variance: Bools
    """The thesis's Var(d) is that of linked zones."""
    stands_alone: Bools
    """It is enough without the transitions that missed detections make."""
    misses: MissedTransitions | None
    """These transitions; None if none were looked for."""

    @property
    def significant(self) -> Bools:
        """Mask (P,) of the links, those that exist only because of missed detections included."""
        return self.q & self.probability & self.transitions & self.variance

    @property
    def published(self) -> Bools:
        """Mask (P,) of the links to publish."""
        return self.significant & self.stands_alone


class LinkShortfall(NamedTuple):
    """Shortfall of L weak links, (L,) each; nan for links that more traffic does not publish."""

    passages: Floats
    """Number of further objects that must take the link."""
    seconds: Floats
    """Seconds until these objects have taken the link, at the traffic of the window."""


class PublishingRule(NamedTuple):
    """The rule for publishing."""

    settings: Settings
    """Its limits."""

    def is_often_taken(self, probability: Floats) -> Bools:
        """Return a mask (n,): enough of the departures at a zone take a link, by their share."""
        often: Bools = probability >= self.settings.publish_probability_min
        return often

    def judge(self, table: LinkTable, views: Views | None = None) -> Verdict:
        """Return which clauses the P pairs of zones of a table meet.

        views: views whose cameras may have missed passages; None if this makes no transitions of
            the table.
        """
        total, share = table.transit.total, table.probability
        verdict = Verdict(
            q=table.q <= self.settings.publish_q_max,
            probability=self.is_often_taken(share),
            transitions=total >= TRANSITIONS_MIN,
            variance=table.variance <= LINKED_VARIANCE_MAX,
            stands_alone=np.ones(len(total), np.bool_),
            misses=None,
        )
        if views is None:
            return verdict
        missed_max = self.settings.missed_share_max
        misses = missed_transitions(table, views, verdict.significant, missed_max)
        own_counts = own_transitions(table, misses)
        often = self.is_often_taken(share * own_counts / np.maximum(total, 1e-9))
        return verdict._replace(stands_alone=often & (own_counts >= TRANSITIONS_MIN), misses=misses)

    def shortfall(
        self, weak: LinkTable, between: LinkTable, published_count: int, zones: int, seconds: float
    ) -> LinkShortfall:
        """Return the shortfall of each weak link.

        weak: the L weak links, with the evidence of the fit.
        between: pairs of zones with held-out evidence; a weak link that is not among them has none.
        published_count: number of links that meet the rule already.
        zones: number of zones.
        seconds: duration of the window.
        """
        # Evidence needed for the next link, and held-out evidence so far.
        usual = ratio_needed(published_count + 1, zones * zones, self.settings.publish_q_max)
        nats_needed = usual - np.log(weak.weight)
        held_out = between.evidence_of(weak.source, weak.target)

        # Each further object adds half of the mean evidence of the transitions so far: evidence is
        # the mean of that of the whole window and the held-out one, which comes later. A link that
        # too few take is not published with any number of objects.
        transitions = weak.transit.total
        nats_per_transition = 0.5 * weak.ratio / np.maximum(transitions, 1e-9)
        helps = (nats_per_transition > 0) & self.is_often_taken(weak.probability)
        passages = np.full(len(held_out), np.nan)
        passages[helps] = (nats_needed - held_out)[helps] / nats_per_transition[helps]
        passages = np.maximum(passages, np.maximum(TRANSITIONS_MIN - transitions, 1.0))
        return LinkShortfall(passages, passages * seconds / np.maximum(transitions, 1e-9))
