"""Estimate links, changes and the prediction model from the events of one window.

`refit` is a pure function: it takes events labelled with their zones (a `Scene`) and returns a
`Refit`. `Learner` decides when to call it and makes a version of the result. Links are of two
kinds, each in a `LinkTable`: *visible* links lead *through* the view of one camera (from zone of
entry to zone of exit, with dwell times), the others lead *between* two views (from zone of
departure to zone of arrival, with transit times). The steps, with the sections of the thesis and
of METHOD.md:

1. visible links and usual dwell times: passages through one view (thesis 4.1; METHOD 3, 8)
2. silent cameras (METHOD 11), views that overlap (thesis 4.5; METHOD 9), and the range of the lags
   (METHOD 5)
3. candidates: departures and arrivals that may be of one object (METHOD 5)
4. joint fit: which of them are, for prediction (METHOD 10), then for links (thesis 4.4; METHOD 5)
5. evidence of each pair of zones, by cross-validation (thesis 4.4; METHOD 7), and transit times
   (thesis 4.5; METHOD 8)
6. changes: links that have opened or closed (METHOD 11)
7. the prediction model by the first of these fits: where objects appear next, all weak evidence
   included (thesis 4.6; METHOD 10)
8. the links to publish (METHOD 7), with their Monte Carlo observations (thesis 4.3; METHOD 6)

Zones and clocks (METHOD 2 to 4) come before: `Learner` labels the events with them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from camtopod.arrays import Bools, Floats
from camtopod.event_time import MICROSECONDS
from camtopod.learn.association import (
    CandidateScreen,
    FollowedSources,
    Problem,
    place,
)
from camtopod.learn.changes import (
    CameraSilences,
    ChangePoint,
    find_changes,
    find_repeats,
    find_silences,
    present,
    silent_odds,
)
from camtopod.learn.clocks import Clocks
from camtopod.learn.declarations import zone_weights
from camtopod.learn.lag_range import find_lag_bins, shortest_bins
from camtopod.learn.links import (
    FAINT_TRANSITIONS,
    LinkShortfall,
    LinkTable,
    MissedTransitions,
    PublishingRule,
    Views,
    concatenate_transitions,
    exposed_departures,
    link_evidence,
    select_weak_links,
    tabulate,
    transitions_of,
    visible_transitions,
    with_monte_carlo_variance,
    with_second_opinion,
    with_usual_dwell_times,
    without_cycle,
)
from camtopod.learn.long_paths import long_ranges
from camtopod.learn.next_camera import (
    OverlappingViews,
    Posterior,
    find_overlapping,
    fit_window,
    overlap_table,
    with_doubt,
)
from camtopod.learn.outcomes import Happened, ScoredPrediction, outcomes_of
from camtopod.learn.paths import is_wanted, second_opinion
from camtopod.learn.prediction_model import build_model
from camtopod.learn.settings import Settings
from camtopod.learn.traffic import Scene
from camtopod.learn.window import Window
from camtopod.records import Declared, Model, PathColumns
from camtopod.topology import LagBins, declared_odds, dwell_bins, offset_bins

STEPS = ("candidates", "joint fit", "evidence", "changes", "prediction", "topology")
"""Names of steps 3 to 8, in order; `refit` reports each as it begins. Steps 1 and 2 have no names:
progress shows them as part of the learner's step before, the clocks.
"""


class Known(NamedTuple):
    """Input of a refit beside the window.

    sources_by_place: on a large site, the zones of departure that screening follows for each zone
        of arrival (`CandidateScreen`), by `place` of the zone of arrival; empty on a small site.
    events_learned: number of events learned so far.
    everywhere: True to look at all zones of arrival now and fit twice, as there is no later refit.
    exits: predictions of exits whose outcome is to be estimated, oldest first.
    declarations: what the user has declared of the cameras.
    """

    sources_by_place: Mapping[int, FollowedSources]
    events_learned: int
    everywhere: bool
    exits: Sequence[ScoredPrediction]
    declarations: Declared = Declared()


class Refit(NamedTuple):
    """Result of a refit.

    bins: bins of the lags between views, of the range that was found.
    scene: the labelled events; departures of unknown passages have an estimated time of entry.
    published_links: links between views that meet the rule for publishing.
    visible: links through one view that meet the rule.
    weak: links between views that are likely but do not meet the rule.
    lacks: passages and time that each weak link lacks until it is published.
    significant_links: links between views that are significant over the whole window, those that
        have closed since included.
    changes: links that opened, closed or changed their share.
    silences: intervals without events, one item per camera.
    repeats: how the events of each camera repeat themselves, in words; "" if they do not.
    model: the part of the topology, beside the links, that prediction reads.
    sources_by_place: `Known.sources_by_place` for the next refit.
    outcomes: outcomes of the first exits of `Known.exits`, as far as they are known already; None
        for an exit that is not in the window.
    """

    bins: LagBins
    scene: Scene
    published_links: LinkTable
    visible: LinkTable
    weak: LinkTable
    lacks: LinkShortfall
    significant_links: LinkTable
    changes: list[ChangePoint]
    silences: list[CameraSilences]
    repeats: list[str]
    model: Model
    sources_by_place: dict[int, FollowedSources]
    outcomes: list[Happened | None]


class Associated(NamedTuple):
    """The result of steps 3 to 6.

    between: every pair of zones with expected transitions, with its held-out evidence.
    changes: links that opened, closed or changed their share.
    problem: departures and arrivals, with the ranges of their lags.
    posterior: where objects appear next, all weak evidence included; None if there are no
        departures or no arrivals, so that `between` is empty.
    sources_by_place: `Known.sources_by_place` for the next refit.
    weights (zones, zones): weight of each pair of zones by what was declared; None for 1.
    paths: paths by the second opinion; None where the fit by zones needs none.
    """

    between: LinkTable
    changes: list[ChangePoint]
    problem: Problem
    posterior: Posterior | None
    sources_by_place: dict[int, FollowedSources]
    weights: Floats | None
    paths: PathColumns | None = None


def refit(
    scene: Scene,
    window: Window,
    clocks: Clocks,
    knowledge: Known,
    settings: Settings,
    on_step: Callable[[str], None] = lambda step: None,
) -> Refit:
    """Estimate links, changes and the prediction model from one window of events.

    scene, clocks: the window's events labelled with their zones, in time corrected by the clocks.
    knowledge: results of earlier refits, and exits whose outcome is to be estimated.
    on_step: called with the name of each of `STEPS` as the step begins.
    """
    lengths = dwell_bins()
    zones = len(scene.zones)
    rule = PublishingRule(settings)

    # 1. Visible links, and the usual dwell time for passages of unknown dwell time.
    transitions = visible_transitions(scene, lengths, settings.candidates_max)
    through = tabulate(transitions, scene.entries.astype(float)[:, None], lengths, zones)
    scene = scene._replace(departures=with_usual_dwell_times(scene.departures, through))

    # 2. Silent cameras, recordings in a loop, views that overlap, and the range of lags.
    seconds = window.column("t") / MICROSECONDS
    silences = find_silences(seconds, window.column("camera"), len(window.cameras))
    silent = silent_odds(silences, seconds[0], seconds[-1])[[zone.camera for zone in scene.zones]]
    views = Views(through, silent)
    repeats = find_repeats(window)
    overlaps = find_overlapping(scene.departures.passages(), len(window.cameras), offset_bins())
    overlap = overlap_table(overlaps, len(window.cameras))
    problem = _problem(scene, overlap, settings)
    bins = problem.bins

    # 3. to 7. Links between views, and the prediction model.
    association = associate(scene, problem, silences, overlap, window, knowledge, settings, on_step)
    on_step("prediction")
    association = with_paths(association, scene, window.cameras)
    all_pairs, changes = association.between, association.changes
    verdict = rule.judge(all_pairs, views)
    likely_pairs, model, outcomes = predict_next(
        scene, window, clocks, association, verdict.misses, overlaps, knowledge, settings
    )

    # 8. The links to publish, as they are at present.
    on_step("topology")
    between, likely = (present(pairs, changes, zones, rule) for pairs in (all_pairs, likely_pairs))
    now = rule.judge(between, views) if changes else verdict
    published_links = between.rows(np.flatnonzero(now.published))
    visible = through.rows(np.flatnonzero(rule.judge(through).significant))
    weak = select_weak_links(likely, published_links, zones)
    duration = scene.last - seconds[0]
    return Refit(
        bins=bins,
        scene=scene,
        published_links=with_monte_carlo_variance(published_links, bins),
        visible=with_monte_carlo_variance(visible, lengths),
        weak=weak,
        lacks=rule.shortfall(weak, between, len(published_links.source), zones, duration),
        significant_links=all_pairs.rows(np.flatnonzero(verdict.significant)),
        changes=changes,
        silences=silences,
        repeats=repeats,
        model=replace(
            model, declared=knowledge.declarations if knowledge.declarations != Declared() else None
        ),
        sources_by_place=association.sources_by_place,
        outcomes=outcomes,
    )


def _problem(scene: Scene, overlap: Bools, settings: Settings) -> Problem:
    """Return the departures and arrivals of a window, with the range of their lags.

    overlap (cameras, cameras): as for `find_lag_bins`.
    """
    zones = len(scene.zones)
    view = np.array([zone.camera for zone in scene.zones], np.int32)
    problem = Problem(scene.departures, scene.arrivals, shortest_bins(), zones, scene.last)
    ranges = long_ranges(problem, view, settings.candidates_max)
    problem = problem._replace(bins=find_lag_bins(scene, overlap, ranges), ranges=ranges)
    if ranges is not None and CandidateScreen.is_needed(problem, settings.candidates_max):
        return problem._replace(bins=find_lag_bins(scene, overlap), ranges=None)
    return problem


def with_paths(association: Associated, scene: Scene, cameras: list[str]) -> Associated:
    """Return the result of steps 3 to 6 with the second opinion's evidence and paths, if any."""
    problem, posterior = association.problem, association.posterior
    if posterior is None or not is_wanted(scene, len(cameras)):
        return association
    persistence = posterior.fit.persistence.label
    paths, evidence = second_opinion(
        scene, cameras, problem.bins.lag_min, problem.odds, persistence
    )
    if evidence is not None:
        view = np.array([zone.camera for zone in scene.zones])
        between = with_second_opinion(association.between, evidence, view, problem.zones)
        association = association._replace(between=between)
    return association._replace(paths=paths)


def associate(
    scene: Scene,
    problem: Problem,
    silences: list[CameraSilences],
    overlap: Bools,
    window: Window,
    knowledge: Known,
    settings: Settings,
    on_step: Callable[[str], None],
) -> Associated:
    """Do steps 3 to 6: find the candidates, fit them jointly, test pairs of zones and changes.

    The candidates take most of a refit's memory; all but the likely ones are given up before the
    fits.

    overlap (cameras, cameras): views that overlap (`overlap_table`).
    """
    if not (len(scene.departures.t) and len(scene.arrivals.t)):
        between = tabulate(
            concatenate_transitions([]), np.zeros((problem.zones, 1)), problem.bins, problem.zones
        )
        return Associated(between, [], problem, None, dict(knowledge.sources_by_place), None)

    # 3. Candidates: departures and arrivals within the range of the lags, delayed on long paths.
    on_step("candidates")
    problem = problem._replace(odds=declared_odds(knowledge.declarations, window.cameras))
    view = np.array([zone.camera for zone in scene.zones], np.int32)
    weights = zone_weights(knowledge.declarations, window.cameras, view)
    places = np.array([place(zone.camera, zone.number) for zone in scene.zones])
    learned, everywhere = knowledge.events_learned, knowledge.everywhere
    screen = CandidateScreen(knowledge.sources_by_place)

    candidates = screen.find(problem, places, learned, settings.candidates_max)

    # 4. The joint fits: each arrival has one cause at most, each departure one effect at most.
    on_step("joint fit")
    posterior, fit = fit_window(problem, candidates, overlap)
    del candidates
    if screen.look_again(problem, fit, places, learned, everywhere) and everywhere:
        candidates = screen.find(problem, places, learned, settings.candidates_max)
        posterior, fit = fit_window(problem, candidates, overlap)
        del candidates

    # 5. Evidence: each part of the window is judged by a fit of other parts.
    on_step("evidence")
    first = float(min(problem.departures.t[0], problem.arrivals.t[0]))
    fit, period = without_cycle(problem, fit)
    evidence = link_evidence(problem, fit, first, period)
    between = tabulate(
        transitions_of(fit),
        exposed_departures(problem),
        problem.bins,
        problem.zones,
        ranges=problem.ranges,
    ).with_weights(weights)
    tests = problem.zones**2
    held_out = between.with_evidence(evidence.held_out, tests)
    posterior = with_doubt(posterior, problem, held_out)
    between = between.with_evidence(evidence.both, tests)

    # 6. Links that have opened or closed; departures during a camera's silence do not count.
    on_step("changes")
    changes = find_changes(problem, fit, [silence.intervals for silence in silences])
    return Associated(between, changes, problem, posterior, screen.sources_by_place, weights)


def predict_next(
    scene: Scene,
    window: Window,
    clocks: Clocks,
    association: Associated,
    misses: MissedTransitions | None,
    overlaps: list[OverlappingViews],
    knowledge: Known,
    settings: Settings,
) -> tuple[LinkTable, Model, list[Happened | None]]:
    """Do step 7: fit where objects appear next, make the model, estimate outcomes of exits.

    Return every pair of zones with expected transitions in this fit, the model and the outcomes.

    association: result of steps 3 to 6, with the second opinion.
    overlaps, misses: as for `build_model`.
    """
    problem = association.problem
    bins = problem.bins
    posterior = association.posterior
    model = build_model(
        scene,
        posterior,
        bins,
        window,
        association.changes,
        settings.correct_clocks,
        overlaps,
        misses,
    )
    if posterior is None:
        return association.between, model, []
    model = replace(model, paths=association.paths)

    # The posterior's table of pairs of zones.
    transitions = transitions_of(posterior.fit, FAINT_TRANSITIONS)
    exposure = exposed_departures(problem)
    likely_pairs = tabulate(transitions, exposure, bins, problem.zones, ranges=problem.ranges)
    no_counts = np.zeros((len(likely_pairs.source), 0))  # they take most of the memory
    likely_pairs = likely_pairs._replace(counts=no_counts).with_weights(association.weights)
    likely_pairs = likely_pairs.with_evidence(likely_pairs.ratio, len(posterior.share))

    # Outcomes of the exits of which no further arrival is possible.
    longest = bins.lag_max + float(posterior.delay.max(initial=0.0))
    outcomes = outcomes_of(
        knowledge.exits,
        posterior,
        scene.departures,
        scene.arrivals,
        window.cameras,
        clocks.offset,
        longest,
        scene.last,
    )
    return likely_pairs, model, outcomes
