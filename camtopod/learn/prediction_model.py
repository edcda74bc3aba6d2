"""Convert the posterior of a fit into the `Model` that prediction reads from the topology.

`Posterior` has arrays by number of zone; `Model` has columns by place of the zone in the topology,
where zones are sorted by id, without negligible items. `build_model` is the entry point; each of
its helpers makes one field.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace
from scipy.sparse import vstack

from camtopod.arrays import Floats, Rows, first_of_group, places, rows_by_group
from camtopod.columns import figures, packed
from camtopod.event_time import MICROSECONDS
from camtopod.learn.assemble import zone_id
from camtopod.learn.association import FOLLOWED_TRANSITIONS_MIN
from camtopod.learn.changes import ChangePoint
from camtopod.learn.links import NEXT_ZONES_MAX, MissedTransitions
from camtopod.learn.next_camera import LEVELS, OverlappingViews, Posterior
from camtopod.learn.traffic import (
    EVENT_SD_SECONDS,
    Persistence,
    Scene,
    label_table,
    usual_dwell_times,
)
from camtopod.learn.window import Window
from camtopod.records import (
    ContextColumns,
    EntryKernelColumns,
    LabelModel,
    Model,
    Onward,
    Overlaps,
    Pace,
)
from camtopod.topology import (
    STAY_DECILES,
    LagBins,
    offset_bins,
    round_significant,
    step_histograms,
    student_share,
)

SHARE_MIN = 1e-4
"""Least share of a listed next zone, and least mass of a listed entry kernel. A share in the window
that is less counts as this where a changed share is divided by it.
"""


def build_model(
    scene: Scene,
    posterior: Posterior | None,
    bins: LagBins,
    window: Window,
    changes: list[ChangePoint],
    clocks_corrected: bool,
    overlaps: Sequence[OverlappingViews] = (),
    misses: MissedTransitions | None = None,
) -> Model:
    """Return the part of the topology, beside the links, that prediction reads.

    The caller adds ``paths``, those of the second opinion.

    posterior: result of the fit for prediction; None without any departure or arrival.
    bins: bins of the lags.
    changes: links whose share has changed within the window.
    clocks_corrected: True if the links' transit times are in corrected time.
    overlaps: pairs of overlapping views.
    misses: transitions that missed detections make; None for none.
    """
    place = places([zone_id(window.cameras, zone) for zone in scene.zones])
    camera_place = places(window.cameras)
    model = Model(
        bins.scale,
        bins.step,
        bins.lag_min,
        bins.lag_max,
        *_of_zones(place, scene, posterior),
        *_of_cameras(camera_place, window),
        clocks_corrected=clocks_corrected,
        overlaps=_overlaps(camera_place, overlaps, offset_bins(bins.scale, bins.step)),
    )
    if posterior is None:
        return model
    now = _presently(posterior, changes)
    return replace(
        model,
        onward=_onward(place, posterior, now, bins, missed_shares(posterior, scene, bins, misses)),
        entered=_entered(place, posterior, bins),
        contexts=_contexts(place, camera_place, posterior, now),
        pace=_pace(place, scene, posterior.fit.persistence),
        labels=_labels(place, scene, posterior.fit.persistence.label),
    )


def _pace(place: Rows, scene: Scene, persistence: Persistence) -> Pace | None:
    """Return how far slowness persists, and usual dwell times; None if slowness does not matter.

    place (zones,): place of each zone in the topology.
    """
    if persistence.scaling <= 0.0:
        return None
    p = scene.departures.passages()
    pair, _, log_dwell = usual_dwell_times(
        scene.arrivals.zone[p.own], p.zone, p.t - p.since, len(place)
    )
    entry, exit_ = place[pair // len(place)], place[pair % len(place)]
    order = np.lexsort((exit_, entry))
    order = order[np.isfinite(log_dwell[order])]
    scaling, correlation, sd = (round_significant(value) for value in persistence[:3])
    return Pace(
        scaling,
        correlation,
        sd,
        packed(entry[order], np.int32),
        packed(exit_[order], np.int32),
        figures(np.exp(log_dwell[order])),
    )


def _labels(place: Rows, scene: Scene, persistence: float) -> LabelModel | None:
    """Return the labels, their persistence and shares; None if there are none.

    place (zones,): place of each zone in the topology.
    """
    label = scene.arrivals.label
    if label is None or persistence <= 0.0:
        return None
    table = label_table(scene.arrivals.zone, label, len(place), len(scene.labels))
    shares = figures(table[np.argsort(place)])
    return LabelModel(list(scene.labels), round_significant(persistence), shares)


def _of_zones(place: Rows, scene: Scene, posterior: Posterior | None) -> tuple[bytes, bytes, bytes]:
    """Return exits, rate of arrivals from outside, and deciles of dwell times, by zone.

    place (zones,): place of each zone in the topology. Dwell times are those of passages that end
    in the zone.
    """
    d = scene.departures
    passages = np.flatnonzero(np.isfinite(d.since))
    dwell_times = (d.t - d.since)[passages]
    stay = np.zeros((len(place), STAY_DECILES))
    for zone, rows in enumerate(rows_by_group(d.zone[passages], len(place))):
        if len(rows):
            stay[zone] = np.quantile(dwell_times[rows], np.linspace(0.0, 1.0, STAY_DECILES))
    rate = np.array(scene.entries, float) / max(scene.last - scene.first, 1.0)
    if posterior is not None:
        rate = rate * posterior.fit.outside
    by_id = np.argsort(place)
    return (
        packed(np.array(scene.exits)[by_id], np.int32),
        figures(rate[by_id]),
        figures(stay[by_id]),
    )


def _of_cameras(place: Rows, window: Window) -> tuple[bytes, bytes]:
    """Return each camera's share of all events, and the time of its last event.

    place (cameras,): place of each camera in the topology.
    """
    camera = place[window.column("camera")]
    share = np.bincount(camera, minlength=len(place)) / max(len(camera), 1)
    last = np.zeros(len(place))
    np.maximum.at(last, camera, window.column("t") / MICROSECONDS)
    return figures(share), packed(last, np.float64)


def _presently(posterior: Posterior, changes: list[ChangePoint]) -> Floats:
    """Return the ratio (P,) of each pair's present share to its share in the whole window."""
    c = posterior.fit.candidates
    after = {(change.source, change.target): change.after for change in changes}
    factor = np.ones(len(c.source))
    for k, pair in enumerate(zip(c.source.tolist(), c.target.tolist(), strict=True)):
        if pair in after:
            factor[k] = after[pair] / max(float(posterior.share[k]), SHARE_MIN)
    return factor


class _Missed(NamedTuple):
    """Shares of the departures that missed detections add; columns are (W,)."""

    source: Rows
    target: Rows
    share: Floats
    mass: Floats
    """(W, bins) the share by lag."""


def missed_shares(
    posterior: Posterior, scene: Scene, bins: LagBins, misses: MissedTransitions | None
) -> _Missed:
    """Return what missed detections add to the shares that the fit has found, the largest first.

    misses: as for `build_model`.
    """
    if misses is None:
        empty = np.zeros(0, np.intp)
        return _Missed(empty, empty, np.zeros(0), np.zeros((0, bins.size)))

    # The share that the fit lacks, what may be spurious left out.
    c = posterior.fit.candidates
    row, exists = misses.rows_in(c.source, c.target)
    departures = np.bincount(scene.departures.zone, minlength=len(scene.zones))
    share = misses.transitions / departures[misses.source]
    share[exists] -= (posterior.share * (1.0 - posterior.doubt))[row[exists]]

    # By lag.
    order = np.argsort(-share, kind="stable")[: int((share > SHARE_MIN).sum())]
    place, width = misses.place[order, None], misses.width[order, None]
    below = student_share(bins.edges, place, np.maximum(width, EVENT_SD_SECONDS))
    mass = share[order, None] * np.diff(below, axis=1)
    return _Missed(misses.source[order], misses.target[order], mass.sum(axis=1), mass)


def _onward(
    place: Rows, posterior: Posterior, now: Floats, bins: LagBins, misses: _Missed
) -> Onward:
    """Return, for each zone of departure, the next zones with shares and lags.

    place (zones,): place of each zone in the topology.
    now (P,): factor on the share of each pair of zones (`_presently`).

    Where shares and leaving make more than 1, as the messages of the fit, changed shares and missed
    detections may, all of them are scaled to make 1, which leaves their odds as they are.
    """
    # Shares of each zone, with that of leaving, and the hazards likewise, make 1 at most.
    c, zones = posterior.fit.candidates, len(place)
    total = posterior.leave + np.bincount(c.source, posterior.share * now, minlength=zones)
    total = np.maximum(total + np.bincount(misses.source, misses.share, minlength=zones), 1.0)
    now = now / total[c.source]
    share = posterior.share * now

    # By zone, the likeliest pairs of the fit, then those that missed detections join.
    pairs = np.flatnonzero(share > SHARE_MIN)
    pairs = pairs[np.argsort(-share[pairs], kind="stable")]
    pairs = pairs[first_of_group(c.source[pairs], NEXT_ZONES_MAX)]
    extra = np.flatnonzero(first_of_group(misses.source, NEXT_ZONES_MAX))
    scale = 1.0 / total[misses.source[extra]]
    source = place[np.append(c.source[pairs], misses.source[extra])]
    row = np.argsort(source, kind="stable")
    mass = np.concatenate(
        (
            posterior.fit.hazard[pairs] * bins.widths * now[pairs, None],
            misses.mass[extra] * scale[:, None],
        )
    )
    of_fit, zeros = row < len(pairs), np.zeros(len(extra))
    delay = np.append(posterior.delay[pairs], zeros)
    return Onward(
        leave=figures((posterior.leave / total)[np.argsort(place)]),
        number=packed(np.bincount(source, minlength=zones), np.int32),
        to=packed(place[np.append(c.target[pairs], misses.target[extra])][row], np.int32),
        share=figures(np.append(share[pairs], misses.share[extra] * scale)[row]),
        doubt=figures(np.append(posterior.doubt[pairs], zeros)[row]),
        delay=figures(delay[row]),
        missed=packed(~of_fit, np.uint8),
        hazard=step_histograms(mass[row], bins),
    )


def _entered(place: Rows, posterior: Posterior, bins: LagBins) -> EntryKernelColumns:
    """Return the entry kernels with the most mass, sorted by zones.

    place (zones,): place of each zone in the topology.
    """
    p = posterior
    mass = p.entry_hazard * bins.widths
    total = mass.sum(axis=1)
    order = np.flatnonzero(total > SHARE_MIN)
    order = order[np.argsort(-total[order], kind="stable")]
    order = order[first_of_group(p.entry_source[order], NEXT_ZONES_MAX)]
    source, target = place[p.entry_source[order]], place[p.entry_target[order]]
    row = np.lexsort((target, source))
    return EntryKernelColumns(
        packed(source[row], np.int32),
        packed(target[row], np.int32),
        step_histograms(mass[order[row]], bins),
    )


def _overlaps(place: Rows, overlaps: Sequence[OverlappingViews], bins: LagBins) -> Overlaps:
    """Return the overlapping views, sorted by cameras.

    place (cameras,): place of each camera in the topology.
    bins: bins of the offsets.
    """
    views = sorted(overlaps, key=lambda view: (place[view.source], place[view.target]))
    same_masses, other_masses = (
        np.array(rows, float).reshape(-1, bins.size)
        for rows in ([view.same_object for view in views], [view.other_objects for view in views])
    )
    return Overlaps(
        packed(place[[view.source for view in views]] if views else [], np.int32),
        packed(place[[view.target for view in views]] if views else [], np.int32),
        figures(np.minimum(same_masses.sum(axis=1), 1.0)),
        step_histograms(same_masses, bins),
        step_histograms(other_masses, bins),
    )


def _contexts(place: Rows, cameras: Rows, posterior: Posterior, now: Floats) -> ContextColumns:
    """Return the contexts of all levels, sorted by zone of departure.

    place (zones,), cameras (cameras,): places of zones and cameras in the topology.
    now (P,): factor on the share of each pair of zones (`_presently`).
    """
    # The contexts of all levels.
    levels = [
        (level, np.flatnonzero(level.departures >= FOLLOWED_TRANSITIONS_MIN), name == "previous")
        for name, level in zip(LEVELS, posterior.levels, strict=True)
    ]
    zone, part, block = np.concatenate([level.keys[rows] for level, rows, _ in levels]).T
    by_camera = np.repeat([item[2] for item in levels], [len(rows) for _, rows, _ in levels])
    entry, previous = np.full((2, len(zone)), -1)
    entry[~by_camera] = place[part[~by_camera]]
    previous[by_camera] = cameras[part[by_camera]]
    departures = np.concatenate([level.departures[rows] for level, rows, _ in levels])

    # Their transitions, scaled to present shares.
    c = posterior.fit.candidates
    transitions = vstack([level.transitions[rows] for level, rows, _ in levels], format="csr")
    at = np.repeat(np.arange(len(zone)), np.diff(transitions.indptr))
    pair = np.searchsorted(c.source, zone)[at] + transitions.indices
    number = transitions.data.astype(float) * now[pair]
    departures = departures + np.bincount(at, number - transitions.data, minlength=len(zone))
    is_frequent = number > FOLLOWED_TRANSITIONS_MIN
    at, to, number = at[is_frequent], place[c.target[pair[is_frequent]]], number[is_frequent]

    row = np.lexsort((previous, block, entry, place[zone]))
    of_row = np.lexsort((to, np.argsort(row)[at]))
    return ContextColumns(
        number=packed(np.bincount(place[zone], minlength=len(place)), np.int32),
        entry=packed(entry[row], np.int32),
        block=packed(block[row], np.int32),
        previous=packed(previous[row], np.int32),
        departures=figures(np.maximum(departures[row], 0.0)),
        followed=packed(np.bincount(at, minlength=len(zone))[row], np.int16),
        to=packed(to[of_row], np.int32),
        transitions=figures(number[of_row]),
    )
