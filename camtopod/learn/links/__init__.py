"""Links between zones: their figures, the evidence for them, and which of them are published.

A *transition* is a departure and an arrival of one object; the joint fit (`association`) gives the
probability of each. A *link* is a pair of zones with transitions that are not made by chance.

Reading order: `link_table` computes a table with the figures of every pair of zones. For that it
uses `transit_time` (mode, mean and quantiles of the transit times), `significance` (evidence and
false discovery rate), and the thesis's `monte_carlo` observations and `mahalanobis` test.
`visible_links` finds the passages through one view, which make links as well. `cross_validation`
estimates the evidence for each link from held-out events, `common_cycle` that where lights, trains
or lifts make platoons. `missed_detections` finds those that
exist only because a camera misses passages. `publishing` is the rule that says which pairs are
published, and estimates how many passages another one still lacks.
"""

from camtopod.learn.links import mahalanobis as mahalanobis, monte_carlo as monte_carlo
from camtopod.learn.links.common_cycle import without_cycle as without_cycle
from camtopod.learn.links.cross_validation import (
    OUTSIDE_LEAST as OUTSIDE_LEAST,
    link_evidence as link_evidence,
)
from camtopod.learn.links.link_table import (
    FAINT_TRANSITIONS as FAINT_TRANSITIONS,
    MONTE_CARLO_SEED as MONTE_CARLO_SEED,
    NEXT_ZONES_MAX as NEXT_ZONES_MAX,
    TRANSITIONS_MIN as TRANSITIONS_MIN,
    LinkTable as LinkTable,
    PathEvidence as PathEvidence,
    concatenate_transitions as concatenate_transitions,
    exposed_departures as exposed_departures,
    select_weak_links as select_weak_links,
    tabulate as tabulate,
    transitions_of as transitions_of,
    with_monte_carlo_variance as with_monte_carlo_variance,
    with_second_opinion as with_second_opinion,
    zone_pairs_of as zone_pairs_of,
)
from camtopod.learn.links.missed_detections import (
    MissedTransitions as MissedTransitions,
    Views as Views,
)
from camtopod.learn.links.publishing import (
    LinkShortfall as LinkShortfall,
    PublishingRule as PublishingRule,
)
from camtopod.learn.links.significance import (
    PARTS as PARTS,
    evidence_against_unrelated as evidence_against_unrelated,
    expected_by_part as expected_by_part,
    log_likelihood_ratio as log_likelihood_ratio,
    q_values as q_values,
    repeated_evidence as repeated_evidence,
)
from camtopod.learn.links.visible_links import (
    passages_lasting as passages_lasting,
    visible_transitions as visible_transitions,
    with_usual_dwell_times as with_usual_dwell_times,
)
