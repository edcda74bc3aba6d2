"""Topologies of an older form: the model as records by name, and weak links in a list of their own.

Topology files of 0.2 have this form, and those of development versions after it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from camtopod.columns import numbers, packed

STEPS = 250
"""Largest mass of a bin in steps (`camtopod.topology.histograms`)."""
DECILES = np.linspace(0.0, 1.0, 11)
NO_LACKS = {"passages": np.nan, "seconds": np.nan}

Row = dict[str, Any]


def with_columns(topology: Row) -> Row:
    """Return the content of a topology of the older form in the present form.

    Raises KeyError, TypeError, AttributeError or ArithmeticError for content that is not of that
    form; ValueError for one whose numbers are none.
    """
    model = topology["model"]
    zones = {zone["id"]: k for k, zone in enumerate(topology["zones"])}
    cameras = {camera["id"]: k for k, camera in enumerate(topology["cameras"])}
    with np.errstate(over="ignore", invalid="ignore"):  # a number too large is refused later
        tables: dict[str, Callable[[Any], Row]] = {
            "onward": lambda rows: _onward(rows, zones),
            "entered": lambda rows: _ends(rows, zones, "zone", "to") | _hazard(rows),
            "contexts": lambda rows: _contexts(rows, zones, cameras),
            "pace": lambda pace: _pace(pace, zones),
            "overlaps": lambda rows: _overlaps(rows, cameras),
            "paths": lambda rows: _paths(rows, zones, cameras),
            "labels": lambda labels: _labels(labels, zones),
        }
        columns: Row = {
            name: table(model[name])
            for name, table in tables.items()
            if model.get(name) is not None
        }
        if weak := topology.get("weak_links"):
            columns["weak_links"] = _weak_links(weak, zones)
        return topology | {
            "model": model | _of_zones(model, zones) | _of_cameras(model, cameras) | columns
        }


def _column(rows: list[Row], name: str, *default: object, kind: Any = np.float32) -> bytes:
    """Return a field of rows as a column; without a default each row has it."""
    return packed([row.get(name, *default) if default else row[name] for row in rows], kind)


def _ends(rows: list[Row], index: dict[str, int], *names: str) -> Row:
    """Return columns of zones or cameras, by name of the field."""
    return {name: packed([index[row[name]] for row in rows], np.int32) for name in names}


def _histograms(histograms: list[Row]) -> Row:
    """Return histograms as columns."""
    units, steps = [], []
    for histogram in histograms:
        mass, unit = np.array(histogram["mass"], float), float(histogram.get("unit", 1.0))
        if mass.max(initial=0.0) > STEPS or (mass % 1.0).any():
            unit *= mass.max() / STEPS
            mass *= STEPS / mass.max()
        units.append(unit)
        steps.append(np.rint(np.clip(mass, 0.0, STEPS)))
    return {
        "first": _column(histograms, "first", kind=np.int16),
        "bins": packed([len(row) for row in steps], np.int16),
        "unit": packed(units, np.float32),
        "steps": packed(np.concatenate([np.zeros(0), *steps]), np.uint8),
    }


def _hazard(rows: list[Row]) -> Row:
    return {"hazard": _histograms([row["hazard"] for row in rows])}


def _of_zones(model: Row, zones: dict[str, int]) -> Row:
    """Return the columns by zone."""
    departures, rate = np.zeros((2, len(zones)))
    stay = np.zeros((len(zones), len(DECILES)))
    for row in model["zones"]:
        zone = zones[row["zone"]]
        departures[zone], rate[zone] = row["departures"], row["arrival_rate"]
        if row["stay"]:
            stay[zone] = np.interp(DECILES, np.linspace(0.0, 1.0, len(row["stay"])), row["stay"])
    return {
        "departures": packed(np.minimum(departures, 2.0**31 - 1.0), np.int32),
        "arrival_rate": packed(rate, np.float32),
        "stay": packed(stay, np.float32),
    }


def _of_cameras(model: Row, cameras: dict[str, int]) -> Row:
    """Return the columns by camera."""
    share, last = np.zeros((2, len(cameras)))
    for row in model["cameras"]:
        share[cameras[row["camera"]]], last[cameras[row["camera"]]] = (
            row["share"],
            row["last_event"],
        )
    return {"event_share": packed(share, np.float32), "last_event": packed(last, np.float64)}


def _onward(zone_rows: list[Row], zones: dict[str, int]) -> Row:
    zone_rows = sorted(zone_rows, key=lambda row: zones[row["zone"]])
    rows = [successor for row in zone_rows for successor in row["next_"]]
    leave, number = np.ones(len(zones)), np.zeros(len(zones))
    for row in zone_rows:
        leave[zones[row["zone"]]] = row["leave"]
        number[zones[row["zone"]]] += len(row["next_"])
    return {
        "leave": packed(leave, np.float32),
        "number": packed(number, np.int32),
        **_ends(rows, zones, "to"),
        "share": _column(rows, "share"),
        "doubt": _column(rows, "doubt", 0.0),
        "delay": _column([row["hazard"] for row in rows], "delay", 0.0),
        "missed": _column(rows, "missed", False, kind=np.uint8),
        **_hazard(rows),
    }


def _contexts(contexts: list[Row], zones: dict[str, int], cameras: dict[str, int]) -> Row:
    rows = sorted(contexts, key=lambda row: zones[row["zone"]])
    number = np.bincount([zones[row["zone"]] for row in rows], minlength=len(zones))
    entry = [-1 if row.get("entry") is None else zones[row["entry"]] for row in rows]
    block = [-1 if row.get("block") is None else row["block"] for row in rows]
    return {
        "number": packed(number, np.int32),
        "entry": packed(entry, np.int32),
        "block": packed(block, np.int32),
        "previous": packed([cameras.get(row.get("previous") or "", -1) for row in rows], np.int32),
        "departures": _column(rows, "departures"),
        "followed": packed([len(row["to"]) for row in rows], np.int16),
        "to": packed([zones[to] for row in rows for to in row["to"]], np.int32),
        "transitions": packed([x for row in rows for x in row["to"].values()], np.float32),
    }


def _pace(pace: Row, zones: dict[str, int]) -> Row:
    ways = pace["ways"]
    return pace | _ends(ways, zones, "entry", "exit") | {"stay": _column(ways, "stay")}


def _overlaps(rows: list[Row], cameras: dict[str, int]) -> Row:
    return {
        **_ends(rows, cameras, "camera", "to"),
        "share": _column(rows, "share"),
        **{name: _histograms([row[name] for row in rows]) for name in ("same", "others")},
    }


def _paths(rows: list[Row], zones: dict[str, int], cameras: dict[str, int]) -> Row:
    of_zones = all({row["from"], row["to"]} <= zones.keys() for row in rows)
    return {
        "of_zones": of_zones,
        **_ends(rows, zones if of_zones else cameras, "from", "to"),
        **{name: _column(rows, name) for name in ("share", "place", "width")},
    }


def _labels(labels: Row, zones: dict[str, int]) -> Row:
    shares = np.ones((len(zones), len(labels["names"])))
    for zone, row in labels["shares"].items():
        shares[zones[zone]] = row
    return labels | {"shares": packed(shares, np.float32)}


def _weak_links(rows: list[Row], zones: dict[str, int]) -> Row:
    transit = [row["transit"] for row in rows]
    lacks = [row.get("lacks") or NO_LACKS for row in rows]
    names = ("mode", "mean", "sd", "q10", "q50", "q90")
    columns = [
        *(_column(rows, name) for name in ("probability", "transitions")),
        *(_column(transit, name) for name in names),
        *(_column(transit, name, np.nan) for name in ("mean_sd", "q50_sd")),
        *(_column(rows, name) for name in ("q_value", "mahalanobis_variance")),
        *(_column(lacks, name) for name in ("passages", "seconds")),
    ]
    figures = np.stack([numbers(raw, np.float32, len(rows)) for raw in columns], axis=1)
    return {
        **_ends(rows, zones, "from", "to"),
        "overlapped": packed([row["relation"] == "overlapped" for row in rows], np.uint8),
        "figures": packed(figures, np.float32),
        "provisional": [row.get("provisional", "") for row in rows],
    }
