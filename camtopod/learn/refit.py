"""One estimate of the topology from one window: the chain of the thesis, step by step.

`refit` is a pure function. Events that are labelled with their zones go in; links, changes and the
prediction model come out, and nothing is kept. `Learner` decides when to call it and turns what it
finds into versions. The steps, with the thesis's section:

1. visible links and usual dwell times: passages through one view (4.1)
2. silent cameras, and views that overlap (4.5)
3. candidates: departures and arrivals that may be of one object
4. joint fit: which of them are (4.4)
5. evidence of each pair of zones, by cross-validation (4.4)
6. changes: links that have opened or closed
7. the prediction model: where objects appear next, all weak evidence included (4.6)
8. the links to publish, with their Monte Carlo observations (4.3)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from camtopod.arrays import Floats
from camtopod.event_time import MICROSECONDS
from camtopod.learn.association import (
    Candidates,
    CandidateScreen,
    Fit,
    FollowedSources,
    candidates_of_pairs,
    fit_jointly,
    place,
)
from camtopod.learn.changes import CameraSilences, Change, find_changes, find_silences, present
from camtopod.learn.clocks import Clocks
from camtopod.learn.links import (
    TRANSITIONS_MIN,
    WEAK_TRANSITIONS_MIN,
    LinkShortfall,
    LinkTable,
    concatenate_transitions,
    cross_evidence,
    exposed_departures,
    select_weak_links,
    shortfall_of,
    significant,
    tabulate,
    transition_slowness,
    transitions_of,
    visible_transitions,
    with_monte_carlo_variance,
    with_usual_dwell_times,
    without_missed_detections,
)
from camtopod.learn.long_paths import Delayed, with_long_paths
from camtopod.learn.next_camera import (
    OverlappingViews,
    find_overlapping,
    fit_followed,
    followed_of,
    overlap_table,
    views_of,
)
from camtopod.learn.outcomes import Exit, Happened, outcomes_of
from camtopod.learn.prediction_model import build_model
from camtopod.learn.settings import Settings
from camtopod.learn.traffic import Arrivals, Departures, Scene
from camtopod.learn.window import Window
from camtopod.records import Model
from camtopod.topology import LagBins, offset_bins

STEPS = ("candidates", "joint fit", "evidence", "changes", "prediction", "topology")
"""Names of the steps that take long, in this order, as `refit` reports them."""


class Known(NamedTuple):
    """What earlier refits and the stream of events have found.

    followed: the zones screened in as sources of each zone, by `place`; empty on a small site.
    learned: number of events learned so far.
    everywhere: screen every zone now, because no later refit will do so.
    exits: earlier exits whose outcome is asked, oldest first.
    """

    followed: Mapping[int, FollowedSources]
    learned: int
    everywhere: bool
    exits: Sequence[Exit]


class Refit(NamedTuple):
    """What one refit finds.

    scene: the labelled events, with usual dwell times where none was seen.
    published, visible, weak: links between views, links through one view, and links that are likely
        and not yet certain.
    lacks: what each weak link still lacks.
    found: significant links between views, whether or not they are open at present.
    changes, silences: links that opened or closed, and gaps in each camera's events.
    model: what prediction needs beside the links.
    followed: as `Known.followed`, for the next refit.
    happened: outcomes of the first of `Known.exits`; None for an exit that is not in the window.
    """

    scene: Scene
    published: LinkTable
    visible: LinkTable
    weak: LinkTable
    lacks: LinkShortfall
    found: LinkTable
    changes: list[Change]
    silences: list[CameraSilences]
    model: Model
    followed: dict[int, FollowedSources]
    happened: list[Happened | None]


class Associated(NamedTuple):
    """The result of steps 3 to 6.

    between: every pair of zones with expected transitions, with its evidence in nats.
    changes: links that opened or closed.
    late: the departures with the delayed copies of long paths.
    likely: the candidates that are worth following for prediction.
    evidence (pairs,): evidence of the candidates' pairs of zones, nats.
    followed: as `Known.followed`.
    """

    between: LinkTable
    changes: list[Change]
    late: Delayed
    likely: Candidates
    evidence: Floats
    followed: dict[int, FollowedSources]


class Predicted(NamedTuple):
    """The result of step 7.

    likely: every pair of zones by the fit for prediction, weak ones included.
    model: what prediction needs beside the links.
    happened: outcomes of earlier exits.
    """

    likely: LinkTable
    model: Model
    happened: list[Happened | None]


def lag_bins(settings: Settings) -> LagBins:
    """Return the bins of the lags between views."""
    return LagBins(-settings.overlap_max_seconds, settings.transit_max_seconds)


def dwell_bins(settings: Settings) -> LagBins:
    """Return the bins of the dwell times in one view."""
    return LagBins(0.0, settings.transit_max_seconds)


def nothing(settings: Settings, zones: int) -> LinkTable:
    """Return a table of no links."""
    return tabulate(concatenate_transitions([]), np.zeros((zones, 1)), lag_bins(settings), zones)


def refit(
    scene: Scene,
    window: Window,
    clocks: Clocks,
    known: Known,
    settings: Settings,
    on_step: Callable[[str], None] = lambda step: None,
) -> Refit:
    """Estimate links, changes and the prediction model from one window of events.

    scene: the window's events labelled with their zones, in corrected time.
    clocks: the clock offsets with which the times were corrected.
    on_step: called with each of `STEPS` as it begins; what the step before needed is free again.
    """
    bins, zones = lag_bins(settings), len(scene.zones)

    # 1. Visible links, and the usual dwell time where a passage's own is not known.
    transitions = visible_transitions(scene, dwell_bins(settings), settings.candidates_max)
    entries = scene.entries.astype(float)[:, None]
    through = tabulate(transitions, entries, dwell_bins(settings), zones)
    scene = scene._replace(departures=with_usual_dwell_times(scene.departures, through))

    # 2. Silent cameras, and views that overlap.
    seconds = window.column("t") / MICROSECONDS
    silences = find_silences(seconds, window.column("camera"), len(window.cameras))
    views = offset_bins(bins.scale, bins.step)
    overlapping = find_overlapping(views_of(scene), len(window.cameras), views)

    # 3. to 7. Links between views, and the prediction model.
    if len(scene.departures.t) and len(scene.arrivals.t):
        found = associate(scene, silences, overlapping, window, known, settings, on_step)
        on_step("prediction")
        predicted = predict_next(scene, window, clocks, found, overlapping, known, settings)
        every, changes, followed = found.between, found.changes, found.followed
    else:
        every, changes, followed = nothing(settings, zones), list[Change](), dict(known.followed)
        model = build_model(
            window.cameras, scene, None, bins, window, [], settings.correct_clocks, overlapping
        )
        predicted = Predicted(nothing(settings, zones), model, [])

    # 8. The links to publish, as they are at present.
    on_step("topology")
    share_min = settings.publish_probability_min
    between = present(every, changes, zones, share_min)
    likely = present(predicted.likely, changes, zones, share_min)
    camera_of = np.array([zone.camera for zone in scene.zones], np.intp)
    certain = without_missed_detections(
        between, through, significant(between, settings), camera_of, settings
    )
    published = with_monte_carlo_variance(between.rows(np.flatnonzero(certain)), bins)
    visible = through.rows(np.flatnonzero(significant(through, settings)))
    weak = select_weak_links(likely, published, zones)
    observed = scene.last - seconds[0]
    return Refit(
        scene=scene,
        published=published,
        visible=with_monte_carlo_variance(visible, dwell_bins(settings)),
        weak=weak,
        lacks=shortfall_of(weak, between, len(published.source), zones, observed, settings),
        found=every.rows(np.flatnonzero(significant(every, settings))),
        changes=changes,
        silences=silences,
        model=predicted.model,
        followed=followed,
        happened=predicted.happened,
    )


def associate(
    scene: Scene,
    silences: list[CameraSilences],
    overlapping: list[OverlappingViews],
    window: Window,
    known: Known,
    settings: Settings,
    on_step: Callable[[str], None],
) -> Associated:
    """Estimate which arrivals belong to which departures, and what that says of pairs of zones.

    The candidates take most of a refit's memory. They end with this function, but for the likely
    ones, which prediction follows.
    """
    bins, arrivals, cameras = lag_bins(settings), scene.arrivals, len(window.cameras)

    # 3. Candidates: departures, and delayed copies for long paths, within the range of the lags.
    on_step("candidates")
    view = np.array([zone.camera for zone in scene.zones], np.int32)
    late = with_long_paths(scene.departures, arrivals, view, cameras, bins, settings.candidates_max)
    places = [place(camera, scene.zones[zone].number) for camera, zone in late.places()]
    screen = CandidateScreen()
    screen.followed = dict(known.followed)
    candidates = screen.find(
        late.departures,
        arrivals,
        bins,
        np.array(places),
        scene.last,
        known.learned,
        settings.candidates_max,
        everywhere=known.everywhere,
    )
    candidates = late.among(candidates, arrivals)

    # 4. to 6. Joint fit, evidence, changes.
    between, changes, evidence = judge(
        scene, late, candidates, bool(screen.followed), silences, settings, on_step
    )

    overlap = late.overlapping(overlap_table(overlapping, cameras))
    zones = len(late.zone)
    likely = followed_of(late.departures, arrivals, candidates, bins, zones, scene.last, overlap)
    return Associated(between, changes, late, likely, evidence, screen.followed)


def judge(
    scene: Scene,
    late: Delayed,
    candidates: Candidates,
    screened: bool,
    silences: list[CameraSilences],
    settings: Settings,
    on_step: Callable[[str], None],
) -> tuple[LinkTable, list[Change], Floats]:
    """Fit the candidates jointly; return the table of links, the changes, the evidence (pairs,).

    screened: whether unlikely candidates have been left out.
    """
    departures, arrivals, bins, zones = (
        late.departures,
        scene.arrivals,
        lag_bins(settings),
        len(late.zone),
    )

    # 4. The joint fit: each arrival has one cause at most, each departure one effect at most.
    on_step("joint fit")
    fit = fit_jointly(departures, arrivals, candidates, bins, zones, scene.last)

    # 5. Evidence, from parts of the time that did not teach what they judge.
    on_step("evidence")
    first = float(min(scene.departures.t[0], arrivals.t[0]))
    every = with_unlikely(fit, departures, arrivals, bins, zones) if screened else fit
    evidence = cross_evidence(departures, arrivals, every, bins, zones, first, scene.last)
    between = tabulate(
        transitions_of(fit),
        exposed_departures(departures, bins, zones, scene.last),
        bins,
        zones,
        transition_slowness(fit, departures, arrivals, zones),
        late.seconds,
    )
    between = late.links_back(between.with_evidence(evidence, len(scene.zones) ** 2))

    # 6. Links that have opened or closed, gaps of silent cameras apart.
    on_step("changes")
    certain_until = scene.last - bins.lag_max
    gaps = [silence.intervals for silence in silences]
    changes = find_changes(fit, departures, arrivals, certain_until, gaps)
    return between, late.changes_back(changes), evidence


def with_unlikely(
    fit: Fit, departures: Departures, arrivals: Arrivals, bins: LagBins, zones: int
) -> Fit:
    """Return the fit with all candidates of the pairs that may be links, unlikely ones included."""
    pairs = np.flatnonzero(fit.counts.sum(axis=1) >= TRANSITIONS_MIN)
    return fit._replace(
        candidates=candidates_of_pairs(fit.candidates, pairs, departures, arrivals, bins, zones)
    )


def predict_next(
    scene: Scene,
    window: Window,
    clocks: Clocks,
    found: Associated,
    overlapping: list[OverlappingViews],
    known: Known,
    settings: Settings,
) -> Predicted:
    """Fit where objects appear next, weak evidence included; find outcomes of earlier exits."""
    late, bins, cameras = found.late, lag_bins(settings), window.cameras
    zones = len(late.zone)
    posterior = fit_followed(
        late.departures,
        scene.arrivals,
        found.likely,
        bins,
        zones,
        scene.last,
        found.evidence,
        bool(found.followed),
    )

    some = transitions_of(posterior.fit, WEAK_TRANSITIONS_MIN)
    left = exposed_departures(late.departures, bins, zones, scene.last)
    likely = tabulate(some, left, bins, zones, delay=late.seconds).without_counts()
    likely = late.links_back(likely.with_evidence(likely.ratio, len(posterior.share)))
    posterior = late.posterior_back(posterior, len(scene.zones))

    certain_until = scene.last - bins.lag_max - float(late.seconds.max())
    happened = outcomes_of(
        known.exits,
        posterior,
        scene.departures,
        scene.arrivals,
        cameras,
        clocks.offset,
        certain_until,
    )
    model = build_model(
        cameras,
        scene,
        posterior,
        bins,
        window,
        found.changes,
        settings.correct_clocks,
        overlapping,
    )
    return Predicted(likely, model, happened)
