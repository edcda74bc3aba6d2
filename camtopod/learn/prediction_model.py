"""Convert the posterior into the model that prediction reads from the topology."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from camtopod.arrays import Floats, rows_by_group
from camtopod.event_time import MICROSECONDS
from camtopod.learn.assemble import STAY_DECILES, zone_id
from camtopod.learn.changes import Change
from camtopod.learn.next_camera import LEVELS, OverlappingViews, Posterior
from camtopod.learn.traffic import Persistence, Scene, usual_dwell_times
from camtopod.learn.window import Window
from camtopod.records import (
    CameraModel,
    Context,
    EntryKernel,
    Model,
    Onward,
    Outcome,
    Overlap,
    Pace,
    Way,
    ZoneModel,
)
from camtopod.topology import LagBins, offset_bins, round_significant, step_histogram

OUTCOMES_PER_ZONE_MAX = 24
"""Zones listed as the next appearance of objects leaving one zone, the likeliest first."""
ENTRY_KERNELS_PER_ZONE_MAX = 16
"""Entry kernels listed for one zone of entry, those with the most mass first."""
SHARE_MIN = 1e-4
"""Smaller shares and smaller kernels are left out."""
CONTEXT_DEPARTURES_MIN = 0.5
"""Contexts with fewer certain departures are left out."""
CONTEXT_TRANSITIONS_MIN = 0.05
"""Fewer certain transitions of a context are left out."""
SHARE_FLOOR = 1e-3
"""Lower bound on a share in the window when a changed share is divided by it."""


def build_model(
    cameras: list[str],
    scene: Scene,
    posterior: Posterior | None,
    bins: LagBins,
    window: Window,
    changes: list[Change],
    clocks_corrected: bool,
    overlapping: Sequence[OverlappingViews] = (),
) -> Model:
    """Return the part of the topology, beside the links, that prediction reads.

    posterior: None where nothing has left or arrived yet.
    changes: links whose share has changed within the window.
    clocks_corrected: whether the links' transit times are in corrected time.
    overlapping: views that overlap.
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
        onward=_onward(ids, posterior, now, bins),
        entered=_entered(ids, posterior, bins),
        contexts=_contexts(ids, cameras, posterior, now),
        pace=_pace(ids, scene, posterior.fit.persistence),
    )


def _pace(ids: list[str], scene: Scene, persistence: Persistence) -> Pace | None:
    """Return how an object's slowness persists; None where it tells nothing about the next view."""
    if persistence.scaling <= 0.0:
        return None
    p = scene.passages
    stays = usual_dwell_times(p.source, p.target, p.left - p.entered)
    ways = [
        Way(ids[entry], ids[left], round_significant(stay)) for (entry, left), stay in stays.items()
    ]
    scaling, correlation, sd = (round_significant(value) for value in persistence)
    return Pace(scaling, correlation, sd, sorted(ways, key=lambda way: (way.entry, way.exit)))


def _zone_models(ids: list[str], scene: Scene, posterior: Posterior | None) -> list[ZoneModel]:
    """Return each zone's unexplained arrival rate and the deciles of its dwell times."""
    d = scene.departures
    span = max(scene.last - scene.first, 1.0)
    zones = []
    known = np.flatnonzero(np.isfinite(d.since))
    stays = (d.t - d.since)[known]
    for index, (name, mine) in enumerate(
        zip(ids, rows_by_group(d.zone[known], len(ids)), strict=True)
    ):
        stay = stays[mine]
        deciles = (
            [round_significant(float(value)) for value in np.quantile(stay, STAY_DECILES)]
            if len(stay)
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
    """Return the factor (P,) from each pair's share in the window to its present share."""
    c = posterior.fit.candidates
    after = {(change.source, change.target): change.after for change in changes}
    factor = np.ones(len(c.source))
    for k, pair in enumerate(zip(c.source.tolist(), c.target.tolist(), strict=True)):
        if pair in after:
            factor[k] = after[pair] / max(float(posterior.share[k]), SHARE_FLOOR)
    return factor


def _onward(ids: list[str], posterior: Posterior, now: Floats, bins: LagBins) -> list[Onward]:
    c = posterior.fit.candidates
    share = posterior.share * now
    rows = []
    likely = np.flatnonzero(share > SHARE_MIN)
    for zone, mine in enumerate(rows_by_group(c.source[likely], len(ids))):
        pairs = likely[mine]
        pairs = pairs[np.argsort(-share[pairs], kind="stable")][:OUTCOMES_PER_ZONE_MAX]
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
        rows.append(Onward(ids[zone], round_significant(float(posterior.leave[zone])), outcomes))
    return sorted(rows, key=lambda row: row.zone)


def _entered(ids: list[str], posterior: Posterior, bins: LagBins) -> list[EntryKernel]:
    p = posterior
    mass = p.entry_hazard * bins.widths
    total = mass.sum(axis=1)
    rows = []
    likely = np.flatnonzero(total > SHARE_MIN)
    for zone, mine in enumerate(rows_by_group(p.entry_source[likely], len(ids))):
        pairs = likely[mine]
        pairs = pairs[np.argsort(-total[pairs], kind="stable")][:ENTRY_KERNELS_PER_ZONE_MAX]
        rows += [
            EntryKernel(ids[zone], ids[p.entry_target[k]], step_histogram(mass[k], bins))
            for k in pairs.tolist()
        ]
    return sorted(rows, key=lambda row: (row.zone, row.to))


def _overlaps(
    cameras: list[str], overlapping: Sequence[OverlappingViews], bins: LagBins
) -> list[Overlap]:
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
    c = posterior.fit.candidates
    changed = {
        (int(c.source[k]), int(c.target[k])): float(now[k]) for k in np.flatnonzero(now != 1.0)
    }
    result = []
    for name, level in zip(LEVELS, posterior.levels, strict=True):
        # Delayed copies of departures (`long_paths`) share the context of their originals;
        # transitions of both count.
        counted: dict[tuple[int, int, int], tuple[float, float, dict[str, float]]] = {}
        for k in np.flatnonzero(level.departures >= CONTEXT_DEPARTURES_MIN).tolist():
            first, block = (int(part) for part in level.parts[k])
            if name == "previous" and first >= len(cameras):
                continue  # a virtual view: the previous camera is known by a long path only

            # Transitions, scaled to the departures of the originals and to present shares.
            zone, row = int(level.zone[k]), slice(level.first[k], level.first[k + 1])
            sure = float(level.departures[k])
            original, departures, to = counted.get((zone, first, block), (sure, sure, {}))
            transitions = level.transitions[row] * (original / sure)
            for v, mass in zip(level.target[row].tolist(), transitions.tolist(), strict=True):
                moved = mass * changed.get((zone, v), 1.0)
                departures += moved - mass
                if moved > CONTEXT_TRANSITIONS_MIN:
                    to[ids[v]] = round_significant(moved)
            counted[zone, first, block] = original, departures, to
        result += [
            Context(
                ids[zone],
                round_significant(max(departures, 0.0)),
                dict(sorted(to.items())),
                ids[first] if "entry" in name else None,
                block if "block" in name else None,
                cameras[first] if name == "previous" else None,
            )
            for (zone, first, block), (_, departures, to) in counted.items()
        ]
    return sorted(
        result, key=lambda row: (row.zone, row.entry or "", row.block or 0, row.previous or "")
    )
