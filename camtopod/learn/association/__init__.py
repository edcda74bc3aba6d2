"""Data association: which departure and which arrival are of one object.

Reading order: `candidates` lists every departure and arrival within the range of lags; `exposure`
counts how many departures could have been seen to arrive after each lag; `speed_adjustment`
corrects lags for each object's speed; `em` estimates responsibilities and hazards by expectation
maximisation; `joint_fit` runs it for links.
`screening` goes before the fit on large sites, where there are too many candidates for it.
"""

from __future__ import annotations

from camtopod.learn.association.candidates import (
    RESPONSIBILITY_MAX,
    Candidates,
    find_candidates,
    first_hazards,
    in_reach,
    newest,
    together,
)
from camtopod.learn.association.em import NOTHING, START_FLOOR, Em
from camtopod.learn.association.exposure import exposures
from camtopod.learn.association.joint_fit import Fit, fit_jointly, result
from camtopod.learn.association.screening import (
    Followed,
    Screen,
    ends_of,
    followed_above_chance,
    not_overlapping,
    place,
    whole,
)
from camtopod.learn.association.speed_adjustment import adjust

__all__ = [
    "NOTHING",
    "RESPONSIBILITY_MAX",
    "START_FLOOR",
    "Candidates",
    "Em",
    "Fit",
    "Followed",
    "Screen",
    "adjust",
    "ends_of",
    "exposures",
    "find_candidates",
    "first_hazards",
    "fit_jointly",
    "followed_above_chance",
    "in_reach",
    "newest",
    "not_overlapping",
    "place",
    "result",
    "together",
    "whole",
]
