"""Rename the zones of foreign cameras in a part to the ids that their owners gave them.

Several zones of the district that are one zone of the owner's are combined, weighted by their
number of events. Where one zone is several of the owner's, its predictions are used for each of
them.
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
"""Owners' ids of each zone, the one at its position first; others are unknown to their owner."""


def with_owners_ids(part: Topology, names: Names) -> Topology:
    """Return the topology of a part with the owners' ids.

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
    leaving: dict[str, float] = defaultdict(float)
    for zone, (first, *_) in names.items():
        leaving[first] += exits[zone]
    grouped: dict[LinkKey, list[Link]] = defaultdict(list)
    for link in links:
        if link.from_ in names:
            grouped[link_key(replace(link, from_=names[link.from_][0]))].append(link)
    return [_one_link(key[0], same, exits, leaving[key[0]]) for key, same in grouped.items()]


def _one_link(source: str, links: list[Link], exits: dict[str, float], leaving: float) -> Link:
    """Combine links from several zones that are one of the owner's.

    Transit times are those of the strongest link.
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
    share = sum(weight * outcome.share for weight, outcome in outcomes)
    doubt = sum(weight * outcome.share * outcome.doubt for weight, outcome in outcomes) / max(
        share, 1e-300
    )
    hazard = sum_as_steps([(weight, outcome.hazard) for weight, outcome in outcomes])
    return Outcome(target, round_significant(share), hazard, round_significant(doubt))


def _entered(
    kernels: Iterable[EntryKernel], members: dict[str, list[str]], entries: dict[str, float]
) -> list[EntryKernel]:
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
    """Return the contexts with owners' ids; counts of those that are one for the owner add up."""
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
    source, arrow, target = alarm.subject.partition("->")
    return replace(alarm, subject=f"{names.get(source, [source])[0]}->{target}") if arrow else alarm
