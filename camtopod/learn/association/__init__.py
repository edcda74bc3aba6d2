"""Data association: which departure and which arrival are of one object.

Reading order: `candidates` lists every departure and arrival within the range of lags; `exposure`
counts how many departures could have been seen to arrive after each lag; `joint_fit` estimates the
responsibility of each candidate and the hazards of each pair of zones by expectation maximisation.
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
from camtopod.learn.association.exposure import exposures
from camtopod.learn.association.joint_fit import (
    NOTHING,
    START_FLOOR,
    Fit,
    JointFitter,
    Tables,
    adjust,
    fit_jointly,
    within,
)
from camtopod.learn.association.screening import (
    Followed,
    Screen,
    ends_of,
    followed_above_chance,
    not_overlapping,
    place,
    whole,
)

__all__ = [
    "NOTHING",
    "RESPONSIBILITY_MAX",
    "START_FLOOR",
    "Candidates",
    "Fit",
    "Followed",
    "JointFitter",
    "Screen",
    "Tables",
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
    "together",
    "whole",
    "within",
]
