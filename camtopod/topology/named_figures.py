"""What a model says by name: its weak links, and figures of zones and cameras."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from msgspec.structs import astuple

from camtopod.columns import numbers, packed
from camtopod.records import Lacks, Link, Topology, Transit, WeakLinks, Zone
from camtopod.topology.histograms import DIGITS

NO_LACKS = (math.nan, math.nan)


def by_name(names: Iterable[str], raw: bytes, kind: type[Any] = np.float32) -> dict[str, Any]:
    """Return the numbers of a column with one for each name, those that are not 0."""
    sequence = list(names)
    column = numbers(raw, kind, len(sequence)).tolist()
    return {name: number for name, number in zip(sequence, column, strict=True) if number}


def last_events(topology: Topology) -> dict[str, float]:
    """Return, by camera, the time of its last learned event, Unix seconds."""
    if topology.model is None:
        return {}
    return by_name(
        (camera.id for camera in topology.cameras), topology.model.last_event, np.float64
    )


def weak_columns(links: Sequence[Link], zones: Sequence[Zone]) -> WeakLinks | None:
    """Return weak links as columns, without histograms; None if there are none.

    zones: those of the topology. Raises KeyError for a link of another zone.
    """
    if not links:
        return None
    index = {zone.id: k for k, zone in enumerate(zones)}
    figures = [
        (
            *(link.probability, link.transitions, *astuple(link.transit)),
            *(link.q_value, link.mahalanobis_variance),
            *(NO_LACKS if link.lacks is None else astuple(link.lacks)),
        )
        for link in links
    ]
    provisional = [link.provisional for link in links]
    return WeakLinks(
        packed([index[link.from_] for link in links], np.int32),
        packed([index[link.to] for link in links], np.int32),
        packed([link.relation == "overlapped" for link in links], np.uint8),
        packed(np.array(figures, float), np.float32),
        provisional if any(provisional) else [],
    )


def weak_links(topology: Topology) -> list[Link]:
    """Return the weak links of a version; `Link.lacks` says what each lacks to be published."""
    columns = topology.model.weak_links if topology.model is not None else None
    if columns is None:
        return []
    source, to = (numbers(raw, np.int32, -1).tolist() for raw in (columns.from_, columns.to))
    overlaps = numbers(columns.overlapped, np.uint8, len(to)).tolist()
    provisional = columns.provisional or [""] * len(to)
    links = []
    for k, row in enumerate(numbers(columns.figures, np.float32, len(to), 14).tolist()):
        short: list[Any] = [None if math.isnan(x) else float(f"{x:.{DIGITS}g}") for x in row]
        links.append(
            Link(
                topology.zones[source[k]].id,
                topology.zones[to[k]].id,
                "overlapped" if overlaps[k] else "unseen",
                short[0],
                short[1],
                Transit(*short[2:10]),
                short[10],
                short[11],
                lacks=None if short[12] is None else Lacks(*short[12:]),
                provisional=provisional[k],
            )
        )
    return links
