"""links"""

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
