"""Rename the zones of foreign cameras in a part to the ids that their owners gave them.

The *owner* of a zone is the district of its camera. Each district finds the zones of a foreign
camera on its own, so its zones may differ from the owner's. If several zones of the district are
one zone of the owner, their links and predictions are combined, weighted by number of events. If
one zone of the district is several zones of the owner, its predictions are used for each of these.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

from msgspec.structs import replace

from camtopod.records import (
    Alarm,
    Context,
    EntryKernel,
    Histogram,
    Link,
    Model,
    Onward,
    Outcome,
    Topology,
)
from camtopod.topology import LinkKey, link_key, round_significant, sum_as_counts, sum_as_steps

Names = dict[str, list[str]]
"""Owners' ids of each zone, by the district's id; the owner's zone at the same position is first.

Zones that are not in it are unknown to their owner.
"""


def with_owners_ids(part: Topology, names: Names) -> Topology:
    """Return the topology of a part with the owners' ids of its zones.

    Links, next appearances and contexts that begin at zones unknown to their owner are left out.
    """
    exits = {zone.id: float(zone.exits) for zone in part.zones}
    links = _links(part.links, names, exits)

    # A weak link gives way to a link between the same zones.
    keys = {(link.from_, link.to) for link in links if link.relation != "visible"}
    weak = [
        link
        for link in _links(part.weak_links or [], names, exits)
        if (link.from_, link.to) not in keys
    ]
    model = None if part.model is None else _model(part, part.model, names, exits)
    return replace(
        part,
        links=links,
        weak_links=weak,
        model=model,
        alarms=[_alarm(alarm, names) for alarm in part.alarms or []],
    )


def _links(links: Iterable[Link], names: Names, exits: dict[str, float]) -> list[Link]:
    """Return links with the owners' ids, combined where these are the same.

    exits: number of exits by the district's id of the zone.
    """
    leaving: dict[str, float] = defaultdict(float)
    for zone, (first, *_) in names.items():
        leaving[first] += exits[zone]
    grouped: dict[LinkKey, list[Link]] = defaultdict(list)
    for link in links:
        if link.from_ in names:
            grouped[link_key(replace(link, from_=names[link.from_][0]))].append(link)
    return [_one_link(key[0], same, exits, leaving[key[0]]) for key, same in grouped.items()]


def _one_link(source: str, links: list[Link], exits: dict[str, float], leaving: float) -> Link:
    """Combine links from several zones of the district that are one zone of the owner.

    source: the owner's id.
    exits: number of exits by the district's id of the zone.
    leaving: number of exits at all zones of the district that are this zone of the owner.

    The transit times are those of the link with the most transitions.
    """
    if len(links) == 1 and exits[links[0].from_] == leaving:
        return replace(links[0], from_=source)
    strongest = max(links, key=lambda link: (link.transitions, link.from_))
    shapes = [(1.0, link.histogram) for link in links if link.histogram is not None]
    return replace(
        strongest,
        from_=source,
        probability=round_significant(
            sum(exits[link.from_] * link.probability for link in links) / max(leaving, 1.0)
        ),
        transitions=round_significant(sum(link.transitions for link in links)),
        histogram=sum_as_counts(shapes) if shapes else None,
    )


def _model(part: Topology, model: Model, names: Names, exits: dict[str, float]) -> Model:
    """Return the model of a part with the owners' ids.

    exits: number of exits by the district's id of the zone.
    """
    members: dict[str, list[str]] = defaultdict(list)
    for zone, owned in names.items():
        for owner in owned:
            members[owner].append(zone)
    entries = {zone.id: float(zone.entries) for zone in part.zones}
    return replace(
        model,
        onward=None if model.onward is None else _onward(model.onward, members, exits),
        entered=None if model.entered is None else _entered(model.entered, members, entries),
        contexts=None if model.contexts is None else _contexts(model.contexts, names),
    )


def _onward(
    rows: Iterable[Onward], members: dict[str, list[str]], exits: dict[str, float]
) -> list[Onward]:
    """Return the next appearances by the owners' zones.

    members: ids of the district's zones by the owner's id.
    exits: number of exits by the district's id of the zone.
    """
    row_of = {row.zone: row for row in rows}
    result = []
    for owner, zones in members.items():
        known = [(exits[zone], row_of[zone]) for zone in zones if zone in row_of]
        if len(known) == 1 and len(zones) == 1:
            result.append(replace(known[0][1], zone=owner))
        elif known:
            result.append(_one_row(owner, known, max(sum(exits[zone] for zone in zones), 1.0)))
    return result


def _one_row(owner: str, rows: list[tuple[float, Onward]], leaving: float) -> Onward:
    """Return the mean of next appearances from several zones, weighted by exits.

    owner: the owner's id.
    rows: (exits, next appearances) of each zone.
    leaving: exits of all these zones.
    """
    to: dict[str, list[tuple[float, Outcome]]] = defaultdict(list)
    for number, row in rows:
        for outcome in row.next_:
            to[outcome.to].append((number / leaving, outcome))
    appear = sum(number * (1.0 - row.leave) for number, row in rows) / leaving
    return Onward(
        owner,
        round_significant(1.0 - appear),
        [_one_outcome(target, same) for target, same in to.items()],
    )


def _one_outcome(target: str, outcomes: list[tuple[float, Outcome]]) -> Outcome:
    """Return the weighted sum of outcomes, given as (weight, outcome), at one next zone."""
    share = sum(weight * outcome.share for weight, outcome in outcomes)
    doubt = sum(weight * outcome.share * outcome.doubt for weight, outcome in outcomes) / max(
        share, 1e-300
    )
    hazard = sum_as_steps([(weight, outcome.hazard) for weight, outcome in outcomes])
    return Outcome(target, round_significant(share), hazard, round_significant(doubt))


def _entered(
    kernels: Iterable[EntryKernel], members: dict[str, list[str]], entries: dict[str, float]
) -> list[EntryKernel]:
    """Return the entry kernels by the owners' zones, as means weighted by entries.

    members: ids of the district's zones by the owner's id.
    entries: number of entries by the district's id of the zone.
    """
    of_zone: dict[str, dict[str, Histogram]] = defaultdict(dict)
    for kernel in kernels:
        of_zone[kernel.zone][kernel.to] = kernel.hazard
    result = []
    for owner, zones in members.items():
        total = max(sum(entries[zone] for zone in zones), 1.0)
        for target in sorted({target for zone in zones for target in of_zone.get(zone, {})}):
            known = [
                (zone, of_zone[zone][target]) for zone in zones if target in of_zone.get(zone, {})
            ]
            alone = known[0][1] if len(zones) == 1 else None
            hazard = alone or sum_as_steps(
                [(entries[zone] / total, hazard) for zone, hazard in known]
            )
            result.append(EntryKernel(owner, target, hazard))
    return result


def _contexts(rows: Iterable[Context], names: Names) -> list[Context]:
    """Return contexts with the owners' ids, adding up counts of contexts that become the same."""
    result: dict[tuple[str, str | None, int | None, str | None], Context] = {}
    for row in rows:
        entry = None if row.entry is None else names.get(row.entry, [None])[0]
        if row.entry is not None and entry is None:
            continue
        for owner in names.get(row.zone, []):
            key = owner, entry, row.block, row.previous
            before = result.get(key)
            if before is None:
                result[key] = replace(row, zone=owner, entry=entry)
                continue
            to = dict(before.to)
            for target, number in row.to.items():
                to[target] = round_significant(to.get(target, 0.0) + number)
            result[key] = replace(
                before, departures=round_significant(before.departures + row.departures), to=to
            )
    return list(result.values())


def _alarm(alarm: Alarm, names: Names) -> Alarm:
    """Return an alarm with the owner's id of the zone where its link begins, if it is of a link."""
    source, arrow, target = alarm.subject.partition("->")
    return replace(alarm, subject=f"{names.get(source, [source])[0]}->{target}") if arrow else alarm
