"""Convert the posterior of a fit into the `Model` that prediction reads from the topology.

`Posterior` has arrays by number of zone; `Model` has records by public id of the zone, without
negligible items. `build_model` is the entry point; each of its helpers makes one field.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from msgspec import UNSET, UnsetType
from msgspec.structs import replace

from camtopod.arrays import Floats, Rows, rows_by_group
from camtopod.event_time import MICROSECONDS
from camtopod.learn.assemble import STAY_DECILES, zone_id
from camtopod.learn.association import FOLLOWED_TRANSITIONS_MIN
from camtopod.learn.changes import Change
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
    CameraModel,
    CameraPath,
    Context,
    EntryKernel,
    LabelModel,
    Model,
    Onward,
    Outcome,
    Overlap,
    Pace,
    Way,
    ZoneModel,
)
from camtopod.topology import (
    LagBins,
    offset_bins,
    round_significant,
    step_histogram,
    student_share,
)

SHARE_MIN = 1e-4
"""Least share of a listed next zone, and least mass of a listed entry kernel. A share in the window
that is less counts as this where a changed share is divided by it.
"""


def build_model(
    cameras: list[str],
    scene: Scene,
    posterior: Posterior | None,
    bins: LagBins,
    window: Window,
    changes: list[Change],
    clocks_corrected: bool,
    overlapping: Sequence[OverlappingViews] = (),
    paths: list[CameraPath] | None = None,
    missed: MissedTransitions | None = None,
) -> Model:
    """Return the part of the topology, beside the links, that prediction reads.

    cameras: names of all cameras.
    posterior: result of the fit for prediction; None without any departure or arrival.
    bins: bins of the lags.
    changes: links whose share has changed within the window.
    clocks_corrected: True if the links' transit times are in corrected time.
    overlapping: pairs of overlapping views.
    paths: the second opinion (`camtopod.learn.paths`); None without one.
    missed: transitions that missed detections make; None for none.
    """
    ids = [zone_id(cameras, zone) for zone in scene.zones]
    zones = sorted(_zone_models(ids, scene, posterior), key=lambda zone: zone.zone)
    model = Model(
        bins.scale,
        bins.step,
        bins.lag_min,
        bins.lag_max,
        zones,
        _camera_models(cameras, window),
        clocks_corrected,
        overlaps=_overlaps(cameras, overlapping, offset_bins(bins.scale, bins.step)),
    )
    if posterior is None:
        return model
    now = _presently(posterior, changes)
    return replace(
        model,
        onward=_onward(ids, posterior, now, bins, missed_shares(posterior, scene, bins, missed)),
        entered=_entered(ids, posterior, bins),
        contexts=_contexts(ids, cameras, posterior, now),
        pace=_pace(ids, scene, posterior.fit.persistence),
        paths=paths,
        labels=_labels(ids, scene, posterior.fit.persistence.label),
    )


def _pace(ids: list[str], scene: Scene, persistence: Persistence) -> Pace | None:
    """Return how far slowness persists, and usual dwell times; None if slowness does not matter.

    ids: public id of each zone.
    """
    if persistence.scaling <= 0.0:
        return None
    p = scene.departures.passages()
    entry = scene.arrivals.zone[p.own]
    pairs, _, log_dwell = usual_dwell_times(entry, p.zone, p.t - p.since, len(ids))
    routes = [
        Way(ids[pair // len(ids)], ids[pair % len(ids)], round_significant(math.exp(log_seconds)))
        for pair, log_seconds in zip(pairs.tolist(), log_dwell.tolist(), strict=True)
        if np.isfinite(log_seconds)
    ]
    scaling, correlation, sd = (round_significant(value) for value in persistence[:3])
    return Pace(scaling, correlation, sd, sorted(routes, key=lambda way: (way.entry, way.exit)))


def _labels(ids: list[str], scene: Scene, persistence: float) -> LabelModel | UnsetType:
    """Return the labels, their persistence and shares; unset if there are none.

    ids: public id of each zone.
    """
    label = scene.arrivals.label
    if label is None or persistence <= 0.0:
        return UNSET
    table = label_table(scene.arrivals.zone, label, len(ids), len(scene.labels))
    shares = {
        name: [round_significant(float(share)) for share in row]
        for name, row in zip(ids, table, strict=True)
    }
    return LabelModel(
        list(scene.labels), round_significant(persistence), dict(sorted(shares.items()))
    )


def _zone_models(ids: list[str], scene: Scene, posterior: Posterior | None) -> list[ZoneModel]:
    """Return, for each zone, exits, rate of arrivals from outside, and deciles of dwell times.

    ids: public id of each zone. Dwell times are those of passages that end in the zone.
    """
    d = scene.departures
    span = max(scene.last - scene.first, 1.0)
    zones = []
    known = np.flatnonzero(np.isfinite(d.since))
    dwell_times = (d.t - d.since)[known]
    for index, (name, rows) in enumerate(
        zip(ids, rows_by_group(d.zone[known], len(ids)), strict=True)
    ):
        dwell = dwell_times[rows]
        deciles = (
            [round_significant(float(value)) for value in np.quantile(dwell, STAY_DECILES)]
            if len(dwell)
            else []
        )
        outside = 1.0 if posterior is None else float(posterior.fit.outside[index])
        rate = outside * float(scene.entries[index]) / span
        zones.append(ZoneModel(name, int(scene.exits[index]), round_significant(rate), deciles))
    return zones


def _camera_models(cameras: list[str], window: Window) -> list[CameraModel]:
    """Return each camera's share of all events and the time of its last event."""
    camera = window.column("camera").astype(np.int64)
    share = np.bincount(camera, minlength=len(cameras)) / max(len(camera), 1)
    last = np.zeros(len(cameras))
    np.maximum.at(last, camera, window.column("t") / MICROSECONDS)
    models = [
        CameraModel(name, round_significant(share[k]), float(last[k]))
        for k, name in enumerate(cameras)
        if share[k] > 0
    ]
    return sorted(models, key=lambda model: model.camera)


def _presently(posterior: Posterior, changes: list[Change]) -> Floats:
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
    posterior: Posterior, scene: Scene, bins: LagBins, missed: MissedTransitions | None
) -> _Missed:
    """Return what missed detections add to the shares that the fit has found, the largest first.

    missed: as for `build_model`.
    """
    if missed is None:
        none = np.zeros(0, np.intp)
        return _Missed(none, none, np.zeros(0), np.zeros((0, bins.size)))

    # The share that the fit lacks, what may be spurious left out.
    c = posterior.fit.candidates
    row, known = missed.rows_in(c.source, c.target)
    departures = np.bincount(scene.departures.zone, minlength=len(scene.zones))
    share = missed.transitions / departures[missed.source]
    share[known] -= (posterior.share * (1.0 - posterior.doubt))[row[known]]

    # By lag.
    listed = np.argsort(-share, kind="stable")[: int((share > SHARE_MIN).sum())]
    place, width = missed.place[listed, None], missed.width[listed, None]
    below = student_share(bins.edges, place, np.maximum(width, EVENT_SD_SECONDS))
    mass = share[listed, None] * np.diff(below, axis=1)
    return _Missed(missed.source[listed], missed.target[listed], mass.sum(axis=1), mass)


def _onward(
    ids: list[str], posterior: Posterior, now: Floats, bins: LagBins, missed: _Missed
) -> list[Onward]:
    """Return, for each zone of departure, the next zones with shares and lags, sorted by zone.

    ids: public id of each zone.
    now (P,): factor on the share of each pair of zones (`_presently`).

    Where shares and leaving make more than 1, as the messages of the fit, changed shares and missed
    detections may, all of them are scaled to make 1, which leaves their odds as they are.
    """
    # Shares of each zone, with that of leaving, and the hazards likewise, make 1 at most.
    c = posterior.fit.candidates
    total = posterior.leave + np.bincount(c.source, posterior.share * now, minlength=len(ids))
    total = np.maximum(total + np.bincount(missed.source, missed.share, minlength=len(ids)), 1.0)
    leave = posterior.leave / total
    now = now / total[c.source]
    share = posterior.share * now

    rows = []
    likely = np.flatnonzero(share > SHARE_MIN)
    added = rows_by_group(missed.source, len(ids))
    for zone, members in enumerate(rows_by_group(c.source[likely], len(ids))):
        # The likeliest pairs of the fit, then those that missed detections join.
        pairs = likely[members]
        pairs = pairs[np.argsort(-share[pairs], kind="stable")][:NEXT_ZONES_MAX]
        mass = posterior.fit.hazard[pairs] * bins.widths * now[pairs, None]
        outcomes = [
            Outcome(
                ids[c.target[k]],
                round_significant(float(share[k])),
                step_histogram(lags, bins, float(posterior.delay[k])),
                round_significant(float(posterior.doubt[k])),
            )
            for k, lags in zip(pairs.tolist(), mass, strict=True)
        ]
        outcomes += [
            Outcome(
                ids[missed.target[k]],
                round_significant(float(missed.share[k] / total[zone])),
                step_histogram(missed.mass[k] / total[zone], bins),
                missed=True,
            )
            for k in added[zone][:NEXT_ZONES_MAX].tolist()
        ]
        rows.append(Onward(ids[zone], round_significant(float(leave[zone])), outcomes))
    return sorted(rows, key=lambda row: row.zone)


def _entered(ids: list[str], posterior: Posterior, bins: LagBins) -> list[EntryKernel]:
    """Return the entry kernels with the most mass, sorted by zones.

    ids: public id of each zone.
    """
    p = posterior
    mass = p.entry_hazard * bins.widths
    total = mass.sum(axis=1)
    rows = []
    likely = np.flatnonzero(total > SHARE_MIN)
    for zone, members in enumerate(rows_by_group(p.entry_source[likely], len(ids))):
        pairs = likely[members]
        pairs = pairs[np.argsort(-total[pairs], kind="stable")][:NEXT_ZONES_MAX]
        rows += [
            EntryKernel(ids[zone], ids[p.entry_target[k]], step_histogram(mass[k], bins))
            for k in pairs.tolist()
        ]
    return sorted(rows, key=lambda row: (row.zone, row.to))


def _overlaps(
    cameras: list[str], overlapping: Sequence[OverlappingViews], bins: LagBins
) -> list[Overlap]:
    """Return the records of overlapping views, sorted by cameras.

    cameras: names of all cameras.
    bins: bins of the offsets.
    """
    rows = [
        Overlap(
            cameras[one.source],
            cameras[one.target],
            round_significant(min(float(one.same.sum()), 1.0)),
            step_histogram(one.same, bins),
            step_histogram(one.others, bins),
        )
        for one in overlapping
    ]
    return sorted(rows, key=lambda row: (row.camera, row.to))


def _contexts(
    ids: list[str], cameras: list[str], posterior: Posterior, now: Floats
) -> list[Context]:
    """Return the contexts of all levels, sorted by zone of departure.

    ids, cameras: public id of each zone, and name of each camera.
    now (P,): factor on the share of each pair of zones (`_presently`).
    """
    c = posterior.fit.candidates
    first = np.searchsorted(c.source, np.arange(len(ids)))
    result = []
    for name, level in zip(LEVELS, posterior.levels, strict=True):
        for k in np.flatnonzero(level.departures >= FOLLOWED_TRANSITIONS_MIN).tolist():
            zone, part, block = level.keys[k].tolist()

            # Transitions, scaled to present shares.
            row = slice(level.moved.indptr[k], level.moved.indptr[k + 1])
            pairs = first[zone] + level.moved.indices[row]
            mass = level.moved.data[row].astype(float)
            moved = mass * now[pairs]
            departures = float(level.departures[k] + (moved - mass).sum())
            to = {
                ids[c.target[pair]]: round_significant(number)
                for pair, number in zip(pairs.tolist(), moved.tolist(), strict=True)
                if number > FOLLOWED_TRANSITIONS_MIN
            }
            result.append(
                Context(
                    ids[zone],
                    round_significant(max(departures, 0.0)),
                    dict(sorted(to.items())),
                    ids[part] if "entry" in name else None,
                    block if "block" in name else None,
                    cameras[part] if name == "previous" else None,
                )
            )
    return sorted(
        result, key=lambda row: (row.zone, row.entry or "", row.block or 0, row.previous or "")
    )
