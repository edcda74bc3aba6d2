"""Data association: estimate which departure and which arrival are of one object.

A *candidate* is a departure and an arrival that may be of one object; its *responsibility* is the
probability that it is. Reading order: `problem` holds the departures and arrivals; `candidates`
lists every two of them within the range of lags. `exposure` counts how many departures could have
been seen to arrive after each lag.
`speed_adjustment` corrects lags for each object's speed. `em` estimates responsibilities and
hazards (rates of arrivals by lag, for each pair of zones) by expectation maximisation, and
`joint_fit` runs it to find links. On large sites, which have too many candidates for one fit,
`screening` selects the candidates first.
"""

from __future__ import annotations

from camtopod.learn.association.candidates import (
    RESPONSIBILITY_MAX,
    Candidates,
    departures_in_reach,
    find_candidates,
    initial_hazards,
    newest_within_limit,
    slices_by_arrival,
)
from camtopod.learn.association.em import NOTHING, START_FLOOR, Em, EmModel
from camtopod.learn.association.exposure import exposures
from camtopod.learn.association.joint_fit import Fit, fit_jointly, result
from camtopod.learn.association.problem import Problem
from camtopod.learn.association.screening import (
    CandidateScreen,
    FollowedSources,
    candidates_of_pairs,
    negative_without_overlap,
    place,
)
from camtopod.learn.association.speed_adjustment import adjust

__all__ = [
    "NOTHING",
    "RESPONSIBILITY_MAX",
    "START_FLOOR",
    "CandidateScreen",
    "Candidates",
    "Em",
    "EmModel",
    "Fit",
    "FollowedSources",
    "Problem",
    "adjust",
    "candidates_of_pairs",
    "departures_in_reach",
    "exposures",
    "find_candidates",
    "fit_jointly",
    "initial_hazards",
    "negative_without_overlap",
    "newest_within_limit",
    "place",
    "result",
    "slices_by_arrival",
]
