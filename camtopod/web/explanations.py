"""Details of a camera, pair or link for the page: figures, and the evidence in plain sentences."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from camtopod.export import seconds
from camtopod.learn.links import MONTE_CARLO_SEED, mahalanobis, monte_carlo
from camtopod.records import Link, Model, Pair, Topology
from camtopod.topology import (
    DWELL_SECONDS_MAX,
    LagBins,
    by_name,
    lacks_in_words,
    last_events,
    link_key,
    masses_on_bins,
    mentions,
    smooth,
    weak_links,
)
from camtopod.web.map_data import nearness, why_provisional
from camtopod.words import alarms_in_words


def empty_camera(camera: str) -> dict[str, Any]:
    """Return what `Explanations.camera` does, of a camera that is not in the version yet."""
    unknown = dict.fromkeys(("clock_offset", "clock_offset_sd", "share", "last_event"))
    return {"id": camera, **unknown, "zones": [], "links": [], "alarms": []}


class Explanations:
    """Details of one version, indexed once for repeated queries."""

    def __init__(self, topology: Topology) -> None:
        self.topology = topology
        self._camera_of = {zone.id: zone.camera for zone in topology.zones}
        self.last_events = last_events(topology)
        """By camera: time of its last learned event, Unix seconds."""
        model = topology.model or Model(1.0, 1.0, 0.0, 1.0, b"")
        self._share = by_name((camera.id for camera in topology.cameras), model.event_share)
        self._departures = by_name(self._camera_of, model.departures, np.int32)
        self._arrival_rate = by_name(self._camera_of, model.arrival_rate)
        self._pairs = {pair.cameras: pair for pair in topology.pairs}

        # Links by key, and by their cameras.
        self._links = {link_key(link): link for link in topology.links}
        weak = weak_links(topology)
        self._weak = {link_key(link): link for link in weak}
        self._between = self._by_cameras(topology.links)
        self._weak_between = self._by_cameras(weak)

    def camera(self, camera: str) -> dict[str, Any] | None:
        """Return a camera's zones, figures and links; None for an unknown camera."""
        entries = [entry for entry in self.topology.cameras if entry.id == camera]
        if not entries:
            return None
        zones = [zone for zone in self.topology.zones if zone.camera == camera]
        rates = self._arrival_rate
        links = [link for ends, group in self._between.items() if camera in ends for link in group]
        return {
            "id": camera,
            "version": self.topology.version,
            "clock_offset": entries[0].clock_offset,
            "clock_offset_sd": entries[0].clock_offset_sd,
            "share": self._share.get(camera),
            "last_event": self.last_events.get(camera),
            "zones": [
                {**msgspec.to_builtins(zone), "arrival_rate": rates.get(zone.id)} for zone in zones
            ],
            "links": [brief(link) for link in links],
            "alarms": [
                alarm
                for alarm in alarms_in_words(self.topology)
                if mentions(alarm.subject, [camera])
            ],
        }

    def pair(self, a: str, b: str) -> dict[str, Any] | None:
        """Return the links between two cameras, both ways and weak ones included; None if none."""
        first, second = sorted((a, b))
        links = self._between.get(frozenset((a, b)), [])
        weak = self._weak_between.get(frozenset((a, b)), [])
        choice = links or weak
        pair = self._pairs.get((first, second))
        if (pair is None and not choice) or first == second:
            return None

        transitions = sum(link.transitions for link in choice)
        best = min(choice, key=nearness, default=None)
        return {
            "cameras": [first, second],
            "relation": pair and pair.relation,
            "provisional": why_provisional(pair, transitions, best),
            "why": [] if best is not None and best.provisional else why_pair(pair),
            "links": [brief(link) for link in links],
            "weak": [brief(link) for link in weak],
        }

    def link(self, from_: str, to: str, relation: str) -> dict[str, Any] | None:
        """Return all details of a link; None for an unknown link.

        ``chart``: ``counts`` and ``curve`` are expected transitions in the lag bins from ``first``
        on, whose edges are ``scale * sinh(step * k)`` seconds. ``background``: unrelated arrivals
        that follow all departures together, per second of lag.
        """
        key = (from_, to, relation)
        link = self._links.get(key) or self._weak.get(key)
        if link is None:
            return None
        departures = self._departures.get(from_)
        background = None
        if departures is not None and to in self._arrival_rate:
            background = departures * self._arrival_rate[to]
        weak = key not in self._links
        return {
            **brief(link),
            "version": self.topology.version,
            "weak": weak,
            "cameras": [self._camera_of[from_], self._camera_of[to]],
            "departures": departures,
            "background": background,
            "chart": _chart(self.topology.model, link),
            "why": why(link, weak, departures, background),
        }

    def _by_cameras(self, links: list[Link]) -> dict[frozenset[str], list[Link]]:
        """Return the links by the cameras of their zones, most transitions first."""
        result: dict[frozenset[str], list[Link]] = {}
        for link in sorted(links, key=lambda link: -link.transitions):
            ends = frozenset((self._camera_of[link.from_], self._camera_of[link.to]))
            result.setdefault(ends, []).append(link)
        return result


def brief(link: Link) -> dict[str, Any]:
    """Return a link without its histogram."""
    content: dict[str, Any] = msgspec.to_builtins(link)
    content.pop("histogram", None)
    return content


def _chart(model: Model | None, link: Link) -> dict[str, Any] | None:
    """Return histogram, fitted curve and Monte Carlo samples; None without a histogram."""
    if model is None or link.histogram is None or not any(link.histogram.mass):
        return None

    # Counts and smoothed curve on the lag bins.
    low, high = model.lag_min, model.lag_max
    if link.relation == "visible":
        low, high = 0.0, max(high, DWELL_SECONDS_MAX)
    bins = LagBins(low, high, model.lag_scale, model.lag_step)
    counts = masses_on_bins(link.histogram, bins)[None]
    if not counts.any():
        return None
    curve = smooth(counts)[0]
    density = curve / bins.widths

    # Samples of the curve, and the range worth drawing.
    samples = monte_carlo.observe(density, np.array([link.transit.sd]), bins, MONTE_CARLO_SEED)
    positions = np.flatnonzero((density[0] > 0.004 * density[0].max()) | (counts[0] > 0))
    columns = slice(int(positions[0]), int(positions[-1]) + 1)
    return {
        "delay": link.histogram.delay,
        "scale": bins.scale,
        "step": bins.step,
        "first": bins.first + int(positions[0]),
        "counts": _short(counts[0, columns]),
        "curve": _short(curve[0, columns]),
        "samples": _short(np.sort(samples[0]) + link.histogram.delay),
    }


def why(link: Link, weak: bool, departures: int | None, background: float | None) -> list[str]:
    """Return the evidence for a link, a sentence each."""
    if link.provisional:
        return [link.provisional, "So what is known of this link is not real."]
    if link.relation == "visible":
        return [
            f"Both zones are in one view: {_count(link.transitions)} objects entered at "
            f"{link.from_} and left at {link.to}, {_share(link.probability)} of those that "
            "entered there.",
            f"Half of them took at most {seconds(link.transit.q50)}; four in five between "
            f"{seconds(link.transit.q10)} and {seconds(link.transit.q90)}.",
        ]

    # A link between views: departures, transit times, background, significance.
    subject = "the objects"
    if departures is not None:
        subject = f"{departures:,} objects"
    sentences = [
        f"Of {subject} that left at {link.from_}, about {_count(link.transitions)} appeared "
        f"next at {link.to}: {_share(link.probability)}.",
        _time_taken(link),
    ]
    if background is not None:
        span = link.transit.q90 - link.transit.q10
        expectation = _count(background * span)
        excess = _count(0.8 * link.transitions)  # those from q10 to q90
        sentences.append(
            f"Within these {seconds(span)} about {expectation} unrelated arrivals are "
            f"expected; {excess} more than that were found."
        )
    sentences.append(
        f"Of links with as much evidence as this one, {_odds(link.q_value)} would be spurious."
    )
    sentences.append(
        f"The variance of its transit times is {_share(link.mahalanobis_variance)} of that of "
        f"unrelated events (Var(d) = {link.mahalanobis_variance:.2g}; the thesis requires at most "
        f"{mahalanobis.LINKED_VARIANCE_MAX:g})."
    )

    if link.contradicted:
        sentences.append(
            "It contradicts not_neighbours in [topology] of the configuration, by which nobody "
            "goes between these cameras without passing another one."
        )

    # Unmet rules of a weak link.
    if weak:
        lacks = f" It lacks {lacks_in_words(link.lacks)}." if link.lacks else ""
        sentences.append(
            "It is not published: it does not meet all of the rule for that yet (among others "
            "publish_q_max and publish_probability_min in [learn] of the configuration)."
            f"{lacks} It is used in predictions only."
        )
    return sentences


def _time_taken(link: Link) -> str:
    """Return a sentence on the transit times of a link."""
    t = link.transit
    if t.q50 < 0:
        return (
            f"They are seen at {link.to} before they leave at {link.from_}, by a median of "
            f"{seconds(-t.q50)}: the two views show the same place."
        )
    sure = f" (known to ± {seconds(t.q50_sd)})" if t.q50_sd is not None else ""
    common = f"{seconds(t.q10)} and {seconds(t.q90)}"
    return f"Half of them need at most {seconds(t.q50)}{sure}; four in five between {common}."


def why_pair(pair: Pair | None) -> list[str]:
    """Return the evidence that two cameras are related, a sentence each."""
    if pair is None:
        return [
            "The evidence is not sufficient to publish this pair. It is used in predictions only."
        ]
    kinds = {
        "overlapped": "their views overlap",
        "unseen_path": "a path that no camera sees joins them",
    }
    sentences = [f"The two cameras are related: {kinds[pair.relation]}."]
    if pair.by_lags is not None and pair.by_lags == pair.by_sum_rule:
        sentences.append("Both tests agree: the times of their events, and their number.")
    elif pair.by_lags is not None:
        verdict = kinds.get(str(pair.by_sum_rule), "not decided, as it could not be tested")
        sentences.append(f"By the times of events: {kinds[pair.by_lags]}.")
        sentences.append(f"By the number of events (table 4.4 of the thesis): {verdict}.")
    if pair.reason:
        sentences.append(f"Reason: {pair.reason}.")
    return sentences


def _short(values: NDArray[np.float64]) -> list[float]:
    """Return the values with three digits."""
    return [float(f"{value:.3g}") for value in values]


def _count(number: float) -> str:
    return f"{number:,.0f}" if number >= 9.5 else f"{number:.1f}".removesuffix(".0")


def _share(value: float) -> str:
    digits = 0 if value >= 0.095 else 1
    return f"{100 * value:.{digits}f} %"


def _odds(q_value: float) -> str:
    """Return a q value in words."""
    if q_value < 1e-6:
        return "less than one in a million"
    return f"about one in {1 / q_value:,.0f}" if q_value < 0.3 else "most"
