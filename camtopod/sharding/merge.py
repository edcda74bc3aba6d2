"""Merge the parts of all districts into one topology, as if one learner had made it.

`merge` is a pure function and does not depend on the order of the parts, as every item has one
*owner*: a camera and its zones belong to the district of the camera, a link to the district of the
camera where it ends. Only predictions are shared: each district predicts which share of the
departures from a zone appears next at its own cameras; the merged topology lists the next
appearances of all districts, and the remaining share leaves the site.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence

import msgspec
from msgspec.structs import replace

from camtopod.learn import OUTCOMES_PER_ZONE_MAX, Settings, with_clock_offsets
from camtopod.records import (
    TOPOLOGY_SCHEMA,
    CameraModel,
    Context,
    Link,
    Model,
    Onward,
    Outcome,
    Pace,
    SelfScore,
    Topology,
    Zone,
)
from camtopod.sharding.match_zones import OwnedZones
from camtopod.sharding.parts import Part
from camtopod.sharding.rename_zones import Names, with_owners_ids
from camtopod.topology import (
    ALARMS_KEPT_MAX,
    DIGITS,
    LEAVE_FLOOR,
    estimate_markov_chain,
    find_camera_pairs,
    link_key,
    round_significant,
    scale_histogram,
)

ContextKey = tuple[str, str | None, int | None, str | None]
"""Zone, zone of entry, image block and previous camera of a context."""
PACE_SHARE_MIN = 0.5
"""Least share of all departures that districts with a pace (the persistence of speed) must have for
a pace to be published.
"""


def merge(parts: Iterable[Part], settings: Settings) -> Topology:
    """Return the topology merged from the newest part of every district.

    Site, epoch, version and digest are left out, and alarms have the version 0.
    """
    # Parts with the owners' zone ids.
    ordered = sorted(parts, key=lambda part: part.district)
    zones = sorted(
        (zone for part in ordered for zone in part.topology.zones if zone.camera in part.rates),
        key=lambda z: z.id,
    )
    places = OwnedZones(zones)
    known = [with_owners_ids(part.topology, _names(part, places)) for part in ordered]

    cameras = sorted(
        (camera for one in known for camera in one.cameras), key=lambda camera: camera.id
    )
    links, weak = _links(known)

    # Convert links to corrected time, for the relations of camera pairs.
    corrected_links = links
    if not settings.correct_clocks:
        corrected_links = with_clock_offsets(
            links, zones, {camera.id: -camera.clock_offset for camera in cameras}
        )

    alarms = sorted(
        (alarm for one in known for alarm in one.alarms or []), key=lambda alarm: alarm.t
    )

    return Topology(
        schema=TOPOLOGY_SCHEMA,
        site="",
        epoch="",
        version=0,
        digest="",
        as_of=max((one.as_of for one in known), default=0.0),
        events=sum(one.events for one in known),
        cameras=cameras,
        zones=zones,
        links=links,
        pairs=find_camera_pairs(zones, corrected_links, settings.overlap_tolerance_seconds),
        weak_links=weak,
        chain=estimate_markov_chain(zones, [*links, *weak], DIGITS),
        model=_model(ordered, known, zones),
        alarms=[replace(alarm, version=0) for alarm in alarms[-ALARMS_KEPT_MAX:]] or None,
        score=_score(known),
    )


def _names(part: Part, places: OwnedZones) -> Names:
    """Return the owners' ids of all zones in a part, by the district's ids.

    places: all zones of the site with their owners' ids.
    """
    own: Names = {zone.id: [zone.id] for zone in part.topology.zones if zone.camera in part.rates}
    return own | places.names(zone for zone in part.topology.zones if zone.camera not in part.rates)


def _links(known: Sequence[Topology]) -> tuple[list[Link], list[Link]]:
    """Return the links and the weak links of all parts, sorted by key.

    known: topologies of the parts, with the owners' ids.

    Where several districts have links from one zone, the shares of its links are scaled down to at
    most 1 together, and those of its weak links to the remaining share.
    """
    # Number of districts with links from each zone.
    districts_with = Counter(
        zone for one in known for zone in _leaving([*one.links, *(one.weak_links or [])])
    )

    # Links of all districts.
    links, weak = (
        [link for one in known for link in getattr(one, name) or []]
        for name in ("links", "weak_links")
    )

    # Limit the shares, links first.
    strong = _leaving(links)
    links = _within(
        links, {zone: 1.0 for zone, districts in districts_with.items() if districts > 1}
    )
    remaining = {
        zone: max(1.0 - strong.get(zone, 0.0), 0.0)
        for zone, districts in districts_with.items()
        if districts > 1
    }
    return sorted(links, key=link_key), sorted(_within(weak, remaining), key=link_key)


def _within(links: Iterable[Link], room: dict[str, float]) -> list[Link]:
    """Return links with their shares scaled down to the limit of their zone of departure.

    room: largest sum of the shares by zone; zones that are not in it have no limit. Visible links
        stay as they are.
    """
    links = list(links)
    taken = _leaving(links)
    return [
        replace(
            link,
            probability=round_significant(link.probability * room[link.from_] / taken[link.from_]),
        )
        if link.relation != "visible" and taken[link.from_] > room.get(link.from_, math.inf)
        else link
        for link in links
    ]


def _leaving(links: Iterable[Link]) -> dict[str, float]:
    """Return the sum of the shares of links between views, by zone of departure."""
    taken: dict[str, float] = defaultdict(float)
    for link in links:
        if link.relation != "visible":
            taken[link.from_] += link.probability
    return taken


def _model(parts: Sequence[Part], known: Sequence[Topology], zones: Sequence[Zone]) -> Model | None:
    """Return the merged model; None if no part has one.

    known: topologies of the parts, with the owners' ids.
    zones: all zones of the site.
    """
    models = [one.model for one in known if one.model is not None]
    if not models:
        return None

    # Each camera's share of all events.
    total = max(sum(rate for part in parts for rate in part.rates.values()), 1e-300)
    rates = {camera: rate / total for part in parts for camera, rate in part.rates.items()}
    cameras = [
        CameraModel(row.camera, round_significant(rates[row.camera]), row.last_event)
        for model in models
        for row in model.cameras
    ]

    # Lists of zones, cameras and overlaps.
    fitted = [model for model in models if model.onward is not None]
    overlaps = [row for one in models for row in one.overlaps or []]
    model = replace(
        models[0],
        overlaps=sorted(overlaps, key=lambda row: (row.camera, row.to)),
        zones=sorted((row for one in models for row in one.zones), key=lambda row: row.zone),
        cameras=sorted(cameras, key=lambda row: row.camera),
    )
    if not fitted:
        return model

    # Next appearances, contexts and pace.
    ids = {zone.id for zone in zones}
    entered = [row for one in fitted for row in one.entered or [] if row.zone in ids]
    return replace(
        model,
        onward=_onward(fitted),
        contexts=_contexts(known),
        pace=_pace(models),
        entered=sorted(entered, key=lambda row: (row.zone, row.to)),
    )


def _onward(models: Iterable[Model]) -> list[Onward]:
    """Return the next appearances that all districts predict at their own cameras."""
    rows: dict[str, list[Onward]] = defaultdict(list)
    for model in models:
        for row in model.onward or []:
            rows[row.zone].append(row)
    return [_outcomes(zone, rows[zone]) for zone in sorted(rows)]


def _outcomes(zone: str, rows: Sequence[Onward]) -> Onward:
    """Return the next appearances from one zone by all districts, given those by each."""
    appear = sum(1.0 - row.leave for row in rows)
    outcomes = sorted(
        (outcome for row in rows for outcome in row.next_), key=lambda outcome: -outcome.share
    )
    outcomes = outcomes[:OUTCOMES_PER_ZONE_MAX]

    # Scale shares down so that the least share leaves the site.
    most = 1.0 - LEAVE_FLOOR
    if appear > most + 1e-9:
        outcomes, appear = [_scaled(outcome, most / appear) for outcome in outcomes], most
    return Onward(zone, round_significant(1.0 - appear), outcomes)


def _scaled(outcome: Outcome, factor: float) -> Outcome:
    """Return an outcome with share and hazard times a factor."""
    return replace(
        outcome,
        share=round_significant(outcome.share * factor),
        hazard=scale_histogram(outcome.hazard, factor),
    )


def _contexts(known: Sequence[Topology]) -> list[Context]:
    """Return the contexts of all zones, with transitions to the cameras of all districts.

    known: topologies of the parts, with the owners' ids.

    Departures and transitions to own cameras are those counted by the owner of the zone;
    transitions to other cameras follow from the predictions of other districts.
    """
    # Owners of zones, shares and contexts of each district.
    owners = {
        zone: k for k, one in enumerate(known) for camera in one.cameras for zone in camera.zones
    }
    shares: dict[str, dict[int, dict[str, float]]] = defaultdict(dict)
    rows: list[dict[ContextKey, Context]] = []
    for k, one in enumerate(known):
        for onward in (one.model and one.model.onward) or []:
            shares[onward.zone][k] = {outcome.to: outcome.share for outcome in onward.next_}
        rows.append({_context_key(row): row for row in (one.model and one.model.contexts) or []})

    # Each owner's contexts, with transitions to other districts' cameras.
    result = []
    for k, contexts in enumerate(rows):
        for key, row in contexts.items():
            if owners[row.zone] == k:
                others = [
                    _expected(row, rows[other].get(key), share)
                    for other, share in sorted(shares[row.zone].items())
                    if other != k
                ]
                result.append(_with(row, others))

    return sorted(
        result,
        key=lambda row: (
            row.zone,
            row.entry or "",
            row.block or 0,
            row.previous or "",
            row.block is not None,
        ),
    )


def _context_key(row: Context) -> ContextKey:
    """Return the key of a context, which is the same in all districts."""
    return row.zone, row.entry, row.block, row.previous


def _expected(own: Context, other: Context | None, share: dict[str, float]) -> dict[str, float]:
    """Return the transitions of a context to another district's cameras, by target.

    own: the context, as counted by the zone's owner.
    other: the same context, as counted by the other district; None if it has none.
    share: share of all departures of the zone by target, as predicted by the other district.

    The departures are the owner's. The share of each target is that in the other district's
    context, or else its share of all departures of the zone.
    """
    if other is None or other.departures <= 0.0:
        return {target: own.departures * part for target, part in share.items()}
    return {
        target: number * own.departures / other.departures for target, number in other.to.items()
    }


def _with(row: Context, others: Iterable[dict[str, float]]) -> Context:
    """Return a context with transitions to other districts' cameras added.

    others: these transitions, by target. If all transitions are more than the departures, they are
        scaled down.
    """
    to = dict(row.to)
    for other in others:
        to |= other
    if len(to) == len(row.to):
        return row
    factor = min(1.0, row.departures / max(sum(to.values()), 1e-300))
    return replace(
        row,
        to={target: round_significant(number * factor) for target, number in sorted(to.items())},
    )


def _pace(models: Sequence[Model]) -> Pace | None:
    """Return the mean of the districts' paces (the persistence of speed), weighted by departures.

    None if too few districts have one (`PACE_SHARE_MIN`).
    """
    weighed = [
        (model.pace, float(sum(zone.departures for zone in model.zones))) for model in models
    ]
    known = [(pace, weight) for pace, weight in weighed if pace is not None and weight > 0.0]
    total = sum(weight for _, weight in known)
    if not known or total < PACE_SHARE_MIN * sum(weight for _, weight in weighed):
        return None
    scaling, correlation, sd = (
        round_significant(sum(getattr(pace, name) * weight for pace, weight in known) / total)
        for name in ("scaling", "correlation", "sd")
    )
    ways = sorted(
        (way for pace, _ in known for way in pace.ways), key=lambda way: (way.entry, way.exit)
    )
    return Pace(scaling, correlation, sd, ways)


def _score(known: Iterable[Topology]) -> SelfScore | None:
    """Return the mean of the districts' scores of their own predictions, weighted by exits.

    Each district predicts with its own versions.
    """
    scores = [one.score for one in known if one.score is not None]
    if not scores:
        return None
    exits = sum(score.exits for score in scores)
    figures = {
        name: round(sum(getattr(score, name) * score.exits for score in scores) / exits, 4)
        for name in msgspec.structs.asdict(scores[0])
        if name not in ("exits", "since_version")
    }
    return SelfScore(
        exits=exits, since_version=min(score.since_version for score in scores), **figures
    )
