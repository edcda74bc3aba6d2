"""Data association: estimate which departure and which arrival are of one object.

A *candidate* is a departure and an arrival that may be of one object; its *responsibility* is the
probability that it is. Reading order: `problem` holds the departures and arrivals; `candidates`
lists every two of them within the range of lags. `exposure` counts how many departures could have
been seen to arrive after each lag. `speed_adjustment` corrects lags for each object's speed. `em`
estimates responsibilities and hazards (rates of arrivals by lag, for each pair of zones) by
expectation maximisation, whose E step is that of `sum_product`, with the additions of an
`em_model`, and `joint_fit` runs it to find links. `flatness` tells how far a lag speaks for a
transition. On large sites, which have too many candidates for one fit, `screening` selects the
candidates first: zones of departure that stand out (`traffic_excess`), and their probable
candidates (`weighing`).
"""

from camtopod.learn.association.candidates import (
    CANDIDATES_AT_ONCE as CANDIDATES_AT_ONCE,
    RESPONSIBILITY_MAX as RESPONSIBILITY_MAX,
    Candidates as Candidates,
    departures_in_reach as departures_in_reach,
    find_candidates as find_candidates,
    initial_hazards as initial_hazards,
    newest_within_limit as newest_within_limit,
    number_pairs as number_pairs,
)
from camtopod.learn.association.convergence import (
    ITERATIONS as ITERATIONS,
    ConvergenceMonitor as ConvergenceMonitor,
)
from camtopod.learn.association.em import (
    NOTHING as NOTHING,
    START_FLOOR as START_FLOOR,
    SWEEPS as SWEEPS,
    Em as Em,
)
from camtopod.learn.association.em_model import EmModel as EmModel
from camtopod.learn.association.joint_fit import (
    FOLLOWED_TRANSITIONS_MIN as FOLLOWED_TRANSITIONS_MIN,
    SPARSITY as SPARSITY,
    Fit as Fit,
    fit_jointly as fit_jointly,
    fit_sparsely as fit_sparsely,
    flatness as flatness,
    result as result,
)
from camtopod.learn.association.negative_lags import (
    negative_without_overlap as negative_without_overlap,
)
from camtopod.learn.association.problem import (
    LagRanges as LagRanges,
    Problem as Problem,
    exposures as exposures,
)
from camtopod.learn.association.screening import (
    PAIRS_FEW as PAIRS_FEW,
    CandidateScreen as CandidateScreen,
    FollowedSources as FollowedSources,
    place as place,
)
from camtopod.learn.association.speed_adjustment import adjust as adjust
from camtopod.learn.association.sum_product import (
    answers as answers,
    claims as claims,
    offers as offers,
)
from camtopod.learn.association.traffic_excess import Traffic as Traffic
from camtopod.learn.association.weighing import (
    LIKELY_MIN as LIKELY_MIN,
    candidates_of_pairs as candidates_of_pairs,
)
