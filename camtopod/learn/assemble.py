"""Assemble the public records of a version from learned arrays: zones, links, camera pairs, chain.

`assemble` makes the `Topology`; `link_records` turns a `LinkTable` into its links. Zones, which are
numbers within the learner, get their public ids. Figures are rounded to six significant digits.
"""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from camtopod.learn.clocks import Clocks
from camtopod.learn.links import LinkShortfall, LinkTable
from camtopod.learn.settings import Settings
from camtopod.learn.traffic import Scene, ZoneRef
from camtopod.learn.window import Window
from camtopod.records import (
    TOPOLOGY_SCHEMA,
    Camera,
    Declared,
    Lacks,
    Link,
    Model,
    Relation,
    Topology,
    Transit,
    Zone,
)
from camtopod.topology import (
    LagBins,
    camera_of,
    counts_histogram,
    find_camera_pairs,
    link_key,
    relation_of,
    round_significant,
    weak_columns,
)


def zone_id(cameras: list[str], zone: ZoneRef) -> str:
    """Return the public id of a zone, ``camera/number``."""
    return f"{cameras[zone.camera]}/{zone.number}"


def zone_records(cameras: list[str], scene: Scene) -> list[Zone]:
    """Return the records of all zones, with the entries and exits in the window, sorted by id.

    cameras: names of all cameras.
    """
    records = []
    for index, zone in enumerate(scene.zones):
        entries = int(scene.entries[index])
        exits = int(scene.exits[index])
        name = zone_id(cameras, zone)
        record = Zone(name, cameras[zone.camera], entries, exits)
        if zone.shape is not None:
            record = replace(
                record,
                x=round_significant(zone.shape.x),
                y=round_significant(zone.shape.y),
                cov=[[round_significant(float(value)) for value in row] for row in zone.shape.cov],
            )
        records.append(record)
    return sorted(records, key=lambda record: record.id)


def link_records(
    cameras: list[str],
    scene: Scene,
    table: LinkTable,
    bins: LagBins,
    relation: Relation | None = None,
    histograms: bool = True,
    lacks: LinkShortfall | None = None,
) -> list[Link]:
    """Return the rows of a link table as link records, sorted by key.

    cameras: names of all cameras.
    bins: bins of the table's lags.
    relation: relation of all these links; None for ``overlapped`` or ``unseen``, by the lags of
        each link.
    histograms: True if the links have their histograms of transit times.
    lacks: for weak links, what each lacks until it is published.
    """
    ids = [zone_id(cameras, zone) for zone in scene.zones]
    t = table.transit
    records = [
        Link(
            ids[table.source[k]],
            ids[table.target[k]],
            relation or relation_of(float(t.ahead[k])),
            round_significant(table.probability[k]),
            round_significant(t.total[k]),
            Transit(
                *(
                    round_significant(value)
                    for value in (t.mode[k], t.mean[k], t.sd[k], *t.quantiles[k])
                ),
                *(round_significant(value) for value in (t.mean_error[k], t.median_error[k])),
            ),
            round_significant(table.q[k]),
            round_significant(table.variance[k]),
            counts_histogram(table.counts[k], bins, float(table.delay[k])) if histograms else None,
            None
            if lacks is None or np.isnan(lacks.passages[k])
            else Lacks(round_significant(lacks.passages[k]), round_significant(lacks.seconds[k])),
        )
        for k in range(len(table.source))
    ]
    return sorted(records, key=link_key)


def with_clock_offsets(links: list[Link], zones: list[Zone], ahead: dict[str, float]) -> list[Link]:
    """Return links with transit times in corrected time converted to the cameras' own clocks.

    zones: the records of all zones.
    ahead (by camera, seconds): clock offsets, positive for a fast clock.

    Histograms stay in corrected time.
    """
    of_zone = {zone.id: ahead[zone.camera] for zone in zones}
    result = []
    for link in links:
        later = of_zone[link.to] - of_zone[link.from_]
        t = link.transit
        if later:
            mode, mean, q10, q50, q90 = (
                round_significant(figure + later)
                for figure in (t.mode, t.mean, t.q10, t.q50, t.q90)
            )
            link = replace(
                link, transit=replace(t, mode=mode, mean=mean, q10=q10, q50=q50, q90=q90)
            )
        result.append(link)
    return result


def with_provisional(links: list[Link], repeats: dict[str, tuple[float, str]]) -> list[Link]:
    """Return links of which those of cameras that repeat themselves are provisional.

    repeats: `AlarmState.repeats`.
    """
    result = []
    for link in links:
        ends = {camera_of(link.from_), camera_of(link.to)}
        reason = " ".join(f"{name} {repeats[name][1]}" for name in sorted(ends & repeats.keys()))
        result.append(replace(link, provisional=reason) if reason else link)
    return result


def with_contradictions(links: list[Link], declarations: Declared | None) -> list[Link]:
    """Return links of which those between cameras declared not to be neighbours are marked."""
    apart = set(declarations.not_neighbours if declarations else [])
    result = []
    for link in links:
        source, target = sorted((camera_of(link.from_), camera_of(link.to)))
        result.append(replace(link, contradicted=True) if (source, target) in apart else link)
    return result


def empty_topology(settings: Settings, bins: LagBins) -> Topology:
    """Return the topology of a site without cameras; the learner adds the remaining fields."""
    correction = settings.correct_clocks
    model = Model(
        bins.scale, bins.step, bins.lag_min, bins.lag_max, b"", clocks_corrected=correction
    )
    return Topology(TOPOLOGY_SCHEMA, "", "", 0, 0.0, 0, "", [], [], [], [], model=model)


def assemble(
    settings: Settings,
    window: Window,
    scene: Scene,
    model: Model,
    clocks: Clocks,
    links: list[Link],
    weak_links: list[Link],
) -> Topology:
    """Return the topology of one version, except for what the learner adds.

    The learner adds site, epoch, version, moment, number of events, alarms, score and digest.

    model: the part of the topology that prediction reads beside the links.
    links, weak_links: with transit times in corrected time.
    """
    # Zones by camera.
    zones = zone_records(window.cameras, scene)
    of_camera: dict[str, list[str]] = {name: [] for name in sorted(window.cameras)}
    for zone in zones:
        of_camera[zone.camera].append(zone.id)

    # Clock offsets, and those by which transit times are converted (none in corrected time).
    links = sorted(with_contradictions(links, model.declared), key=link_key)
    ahead = {
        name: round_significant(float(clocks.offset[k])) for k, name in enumerate(window.cameras)
    }
    sd = {
        name: round_significant(float(clocks.sd[k]))
        for k, name in enumerate(window.cameras)
        if np.isfinite(clocks.sd[k])
    }
    shift = dict.fromkeys(ahead, 0.0) if settings.correct_clocks else ahead

    return Topology(
        schema=TOPOLOGY_SCHEMA,
        site="",
        epoch="",
        version=0,
        as_of=0.0,
        events=0,
        digest="",
        cameras=[Camera(name, ids, ahead[name], sd.get(name)) for name, ids in of_camera.items()],
        zones=zones,
        links=with_clock_offsets(links, zones, shift),
        pairs=find_camera_pairs(zones, links, settings.overlap_tolerance_seconds),
        model=replace(
            model, weak_links=weak_columns(with_clock_offsets(weak_links, zones, shift), zones)
        ),
    )
