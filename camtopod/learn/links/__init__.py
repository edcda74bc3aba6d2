"""Links between zones: their figures, the evidence for them, and which of them are published.

Reading order: `link_table` collects the figures of every pair of zones, with `transit_time` (mode,
mean, quantiles), `significance` (evidence and false discovery rate), and the thesis's `monte_carlo`
observations and `mahalanobis` test. `visible_links` does the same for the passages through one
view. Then come the corrections: `cross_validation` (evidence from held-out events),
`missed_detections` (links that are only an effect of missed passages) and `shortfall` (what a weak
link lacks).
"""

from __future__ import annotations

from camtopod.learn.links import mahalanobis, monte_carlo
from camtopod.learn.links.cross_validation import cross_evidence
from camtopod.learn.links.link_table import (
    MONTE_CARLO_SEED,
    TRANSITIONS_MIN,
    WEAK_TRANSITIONS_MIN,
    LinkTable,
    beside,
    join,
    joined_by,
    leaving,
    pace_of,
    refresh_monte_carlo,
    significant,
    tabulate,
    transitions_of,
)
from camtopod.learn.links.missed_detections import joined, without_missed
from camtopod.learn.links.shortfall import Lacking, lacking
from camtopod.learn.links.significance import log_likelihood_ratio, unrelated
from camtopod.learn.links.visible_links import in_view, visible_transitions, with_usual_stays

__all__ = [
    "MONTE_CARLO_SEED",
    "TRANSITIONS_MIN",
    "WEAK_TRANSITIONS_MIN",
    "Lacking",
    "LinkTable",
    "beside",
    "cross_evidence",
    "in_view",
    "join",
    "joined",
    "joined_by",
    "lacking",
    "leaving",
    "log_likelihood_ratio",
    "mahalanobis",
    "monte_carlo",
    "pace_of",
    "refresh_monte_carlo",
    "significant",
    "tabulate",
    "transitions_of",
    "unrelated",
    "visible_transitions",
    "with_usual_stays",
    "without_missed",
]
