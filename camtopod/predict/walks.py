"""Walks: which passages, from view to view, are of one object (contract: one match an entry).

Each entry continues one of the earlier passages, or begins a walk. A passage has at most one
successor in each other view while its object is in view, and one after its exit. So the entries of
the recent past compete for the passages, as in the learner's joint fit: the marginals are those of
the sum-product approximation (Williams and Lau, IEEE Trans. AES 50(4), 2014), over the entries that
have a candidate in common with the new one. The rates are those of prediction (`transitions`,
`hazards`).

A passage belongs to the walk of its likeliest predecessor if that has more than one half; else it
begins a walk. A walk is named by the camera and the time of its oldest passage of the last hour.
`Walks.observe` answers each entry at once; `Walks.revised` answers once more where later events
have changed the answer.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from camtopod.arrays import Floats
from camtopod.codec import require_event
from camtopod.predict.outlook import Departure, anywhere_rates, outlook, outside_rates
from camtopod.predict.passages import UNKNOWN, Passage
from camtopod.predict.recent_events import moved_zones
from camtopod.predict.version import PreparedVersion
from camtopod.predict.walk_graph import ExitOutlook, WalkEdge, WalkStep, pass_messages
from camtopod.predict.walk_memory import CANDIDATES_MAX, EVENTS_MAX, REVISE_SECONDS, WalkMemory
from camtopod.records import Event, Link, Match, MatchedPassage, Topology
from camtopod.topology import LEAVE_FLOOR, block_of, dwell_bins, masses_on_bins

PROBABILITY_MIN = 0.01
"""Least probability of a passage that competes for an entry, and is listed."""
REVISE_CHANGE = 0.1
"""Least change of a probability for which a match is given once more."""
UNSEEN_IN_VIEW = 0.5
"""Prior probability that an object in view has no successor in a given other view by then."""


class Walks:
    """The walks of the last hour, by one version; events come about in order of time."""

    def __init__(
        self,
        topology: Topology,
        prepared_version: PreparedVersion | None = None,
        outside: Sequence[float] | None = None,
    ) -> None:
        """Begin without passages.

        prepared_version: of the same topology, if it is prepared already.
        outside (zones, 1/s): its `outside_rates`, if they are known already.
        """
        self._prepared_version = prepared_version = prepared_version or PreparedVersion(topology)
        self._hazards, self._labels = prepared_version.hazards, prepared_version.labels
        self._outside = outside_rates(prepared_version) if outside is None else outside
        self._nobody_leaves = prepared_version.anywhere.nobody_leaves
        self._dwell_bins = dwell_bins()
        number = {zone.id: k for k, zone in enumerate(topology.zones)}
        self._visible: dict[tuple[int, int | None], Link] = {
            (number[link.from_], number[link.to]): link
            for link in topology.links
            if link.relation == "visible" and link.histogram is not None
        }
        """Visible links by zone of entry and zone of exit."""
        self.forget()

    def forget(self) -> None:
        """Forget all passages; needed when event time has been taken back."""
        self._memory = WalkMemory()

    def forget_cameras(self, cameras: Collection[str]) -> None:
        """Forget the passages of cameras; a passage that continued one of them begins a walk."""
        self._memory.forget_cameras(cameras)

    def take_over(self, older: Walks) -> None:
        """Take over the passages from walks by an older version; this must be new."""
        before = older._prepared_version.zones
        self._memory = older._memory
        self._memory.move(moved_zones(before, self._prepared_version.zones), len(before))

    def observe(self, event: Event, is_matched: bool = True) -> Match | None:
        """Observe an event; return the match of an entry, None for an exit.

        is_matched: False to observe an entry without matching it, which is quick.

        Raise ValueError for an event that is neither entry nor exit, or without a time.
        """
        require_event(event)
        self._memory.forget_old(event.t, self._hazards.lag_max)
        zone = self._prepared_version.zone_of(event)
        t = event.t - self._prepared_version.clock_offset.get(event.camera, 0.0)
        if event.kind == "exit":
            self._end(event, zone, t)
            return None

        # Match the entry with earlier passages.
        step = self._memory.begin(event, zone, t)
        if not is_matched:
            self._memory.add_open(step)
            return None
        if zone is not None:
            step.outside = float(self._outside[zone])
            edges = self._candidates(step, zone)
            if step.exit_t is not None:  # heard before
                edges = [edge for edge in edges if edge.source.entry_t < t]
            for edge in self._likely(step, edges, t):
                edge.add()
            self._settle(step, t)
        self._memory.add_open(step)
        self._memory.recent.append(step)
        return self._match(step)

    def prepare(self, event: Event, outlooks_max: int) -> bool:
        """Compute what the match of an event needs; return True if nothing is missing any more.

        That is the outlook of each passage that an entry may continue; a new version has none.

        outlooks_max: largest number of outlooks to compute.
        """
        zone = self._prepared_version.zone_of(event)
        if event.kind == "exit" or zone is None:
            return True
        t = event.t - self._prepared_version.clock_offset[event.camera]
        steps = [step for step in self._ended_before(zone, t) if step.expected is None]
        for step in steps[:outlooks_max]:
            self._expected(step)
        return len(steps) <= outlooks_max

    def revised(self, now: float, entries_max: int = EVENTS_MAX) -> list[Match]:
        """Return the matches that have changed since their entries, `REVISE_SECONDS` ago.

        now (seconds): time up to which events have been observed. Each entry is looked at once.
        entries_max: largest number of entries to look at; the others wait for the next call.
        """
        self._memory.forget_old(now, self._hazards.lag_max)
        matches = []
        for _ in range(entries_max):
            if not self._memory.recent or self._memory.recent[0].t + REVISE_SECONDS > now:
                break
            step = self._memory.recent.popleft()
            if step.is_final:
                continue
            walk = step.walk
            self._add_late(step)
            self._settle(step, step.entry_t + REVISE_SECONDS)
            has_changed = any(
                abs(edge.probability - edge.match_probability) > REVISE_CHANGE
                for edge in step.edges
            )
            match = self._match(step)
            if has_changed or match.walk != walk:
                matches.append(match)
        return matches

    def _add_late(self, step: WalkStep) -> None:
        """Add the passages whose exit came after the entry that it was earlier than.

        A tracker reports an exit seconds late, once the object has not been found again.
        """
        if step.entry is None:
            return
        source_ids = {id(edge.source) for edge in step.edges}
        candidates = [
            edge
            for edge in self._candidates(step, step.entry)
            if edge.source.entry_t < step.entry_t and id(edge.source) not in source_ids
        ]
        for edge in self._likely(step, candidates, step.entry_t + REVISE_SECONDS):
            edge.add()

    # --- Passages ---

    def _end(self, event: Event, zone: int | None, t: float) -> None:
        """End the passage of an exit; if its entry is unknown, the exit is all of it."""
        open_passages = self._memory.open
        in_view = open_passages.of(event.camera)
        key = str(event.track) if event.track is not None else self._through(in_view, zone, t)
        step = open_passages.end(event.camera, key) or self._memory.begin(event, None, t)
        step.departure_t = t
        step.label = event.label or step.label
        if zone is not None:
            step.block = block_of(event.x, event.y)
        self._memory.end(step, zone, event.t)

    def _expected(self, step: WalkStep) -> ExitOutlook:
        """Return the outlook after a passage that has ended; computed once a version."""
        if step.expected is None:
            passage = self._passage(step) if step.departure_t > step.entry_t else None
            answer = outlook(
                self._prepared_version, Departure(step.zone, step.departure_t, passage, step.block)
            )
            scale = answer.scale
            if answer.table is not None:
                scale = scale / np.maximum(answer.table.outcomes.weight, 1e-300)
            rates = None
            if self._nobody_leaves:
                rates = tuple(anywhere_rates(self._prepared_version, answer).tolist())
            no_arrival = answer.unseen(self._hazards.bins.edges, links_only=not self._nobody_leaves)
            step.expected = ExitOutlook(tuple(scale.tolist()), tuple(no_arrival.tolist()), rates)
        return step.expected

    def _through(self, in_view: Mapping[str, WalkStep], zone: int | None, t: float) -> str:
        """Return the key of the passage without a track that ends in a zone; "" if none does."""
        weights = {}
        for key, step in in_view.items():
            link = self._visible.get((-1 if step.entry is None else step.entry, zone))
            at = self._dwell_bins.bin_of(t - step.entry_t)
            if step.track is None and link is not None and at >= 0:
                weights[key] = self._dwell_density(link)[at]
        best = max(weights, key=weights.__getitem__, default="")
        return best if weights and weights[best] > 0.5 * sum(weights.values()) else ""

    def _dwell_density(self, link: Link) -> Floats:
        """Return the density (bins, 1/s) of the dwell times of a visible link."""
        assert link.histogram is not None
        per_second = masses_on_bins(link.histogram, self._dwell_bins) / self._dwell_bins.widths
        density: Floats = per_second * link.probability / max(link.transitions, 1e-9)
        return density

    # --- Matching ---

    def _ended_before(self, zone: int, t: float) -> list[WalkStep]:
        """Return the passages that ended where, and when, one may have that goes on at a zone."""
        sources = self._memory.steps_by_exit if self._nobody_leaves else self._hazards.sources(zone)
        return [
            step
            for source in sources
            for step in self._memory.steps_by_exit.get(source, ())
            if 0.0 <= t - step.departure_t <= self._hazards.lag_max
        ]

    def _candidates(self, step: WalkStep, zone: int) -> list[WalkEdge]:
        """Return the passages that the entry of a step may continue."""
        # Passages that have ended.
        t = step.entry_t
        ended_steps = self._ended_before(zone, t)
        weights = np.zeros(len(ended_steps))
        sources = np.array([source_step.zone for source_step in ended_steps], np.int32)
        lag = t - np.array([source_step.departure_t for source_step in ended_steps])
        for source_row, row, rate in zip(
            *(column.tolist() for column in self._hazards.rates_by_row(sources, zone, lag)),
            strict=True,
        ):
            if rate:
                weights[source_row] += rate * self._expected(ended_steps[source_row]).scale[row]
        if self._nobody_leaves:
            for k in np.flatnonzero((lag > 0.0) & (lag <= self._hazards.bins.lag_max)).tolist():
                rates = self._expected(ended_steps[k]).rates
                weights[k] += 0.0 if rates is None else rates[zone]
        if self._labels:
            labels = [self._labels.number(source_step.label) for source_step in ended_steps]
            weights *= self._labels.agreement(labels, self._labels.number(step.label), zone)
        least = PROBABILITY_MIN * step.outside * LEAVE_FLOOR  # else unlikely without rivals, too
        edges = [
            WalkEdge(source_step, step, "", weight)
            for source_step, weight in zip(ended_steps, weights.tolist(), strict=True)
            if weight > least
        ]

        # Passages under way in other views.
        steps_in_view = [
            source_step
            for camera in self._hazards.cameras_before(np.array([zone]))
            for source_step in list(self._memory.open.of(self._hazards.cameras[camera]).values())[
                -CANDIDATES_MAX:
            ]
        ]
        weights_in_view = self._rates_in_view(steps_in_view, step)
        edges += [
            WalkEdge(source_step, step, step.camera, weight)
            for source_step, weight in zip(steps_in_view, weights_in_view, strict=True)
            if weight
        ]
        return self._with_simultaneous(edges, step, zone)

    def _with_simultaneous(
        self, edges: list[WalkEdge], step: WalkStep, zone: int
    ) -> list[WalkEdge]:
        """Add to the edges of an entry what passages that began at the same time add.

        Of passages that began together the one that ends first counts as the earlier one, as in the
        learner. So each of the two may be the cause of the other, and the entry that comes second
        gets both rates: the reverse one as it competes with the other causes of the first entry.
        """
        edge_of_source = {id(edge.source): edge for edge in edges if edge.slot}
        for source_step in reversed(self._memory.recent):
            if source_step.entry_t != step.entry_t:
                break
            if source_step.exit_t is not None:
                continue
            [rate] = self._rates_in_view([step], source_step)
            causes = source_step.outside / max(
                1.0 - sum(edge.probability for edge in source_step.edges), 1e-9
            )
            if rate > 0.0:
                edge = edge_of_source.get(id(source_step)) or WalkEdge(
                    source_step, step, step.camera, 0.0
                )
                edge.weight += rate * step.outside / causes
                edge_of_source[id(source_step)] = edge
        return [edge for edge in edges if not edge.slot] + [*edge_of_source.values()]

    def _rates_in_view(self, source_steps: list[WalkStep], step: WalkStep) -> list[float]:
        """Return the rate (1/s) at which each passage, while in view, causes another to begin."""
        arrival = self._passage(step)
        if arrival is None:
            return [0.0] * len(source_steps)
        passages = [self._passage(source_step) or UNKNOWN for source_step in source_steps]
        rates = self._prepared_version.rates_in_view(
            passages, np.array([arrival.entry]), np.array([arrival.t]), np.array([arrival.label])
        )
        weights: list[float] = rates[:, 0].tolist()
        return weights

    def _passage(self, step: WalkStep) -> Passage | None:
        """Return the passage of a step; None if its entry is unknown."""
        if step.entry is None:
            return None
        label = self._labels.number(step.label)
        return Passage(step.entry_t, step.camera, step.entry, label=label)

    def _likely(self, step: WalkStep, edges: list[WalkEdge], t: float) -> list[WalkEdge]:
        """Return the edges that are likely enough, given what other entries claim."""
        offers = [edge.weight / (self._no_successor(edge, t) + edge.claims.odds) for edge in edges]
        least = PROBABILITY_MIN * (step.outside + sum(offers))
        return [edge for edge, offer in zip(edges, offers, strict=True) if offer >= least]

    def _settle(self, step: WalkStep, t: float) -> None:
        """Update the probabilities of an entry, and the messages of those that compete with it.

        t (seconds): corrected time of the question.
        """
        # The entries that compete; each edge with the odds that its passage has no successor.
        rivals = {id(step): step}
        for edge in step.edges:
            rivals |= {id(rival_edge.entry): rival_edge.entry for rival_edge in edge.claims.edges}
        entries = [
            (rival, [(edge, self._no_successor(edge, t)) for edge in rival.edges])
            for rival in rivals.values()
        ]
        pass_messages(entries)

    def _no_successor(self, edge: WalkEdge, t: float) -> float:
        """Return the probability that an edge's passage has no successor by ``t``."""
        if edge.slot:
            return UNSEEN_IN_VIEW
        no_arrival = self._expected(edge.source).no_arrival
        at = bisect_right(self._hazards.bins.limits, t - edge.source.departure_t)
        return max(no_arrival[min(at, len(no_arrival) - 1)], LEAVE_FLOOR)

    def _match(self, step: WalkStep) -> Match:
        """Give a step its walk, and return its match."""
        edges = sorted(step.edges, key=lambda edge: -edge.probability)
        edges = [edge for edge in edges if edge.probability >= PROBABILITY_MIN]
        is_known = bool(edges) and edges[0].probability > 0.5
        step.before = edges[0].source if is_known else None
        for edge in step.edges:
            edge.match_probability = edge.probability
        rows = [_row(edge) for edge in edges]
        new = 1.0 - sum(row.probability for row in rows)
        return Match(
            step.camera, step.t, self._prepared_version.number, rows, new, step.walk, step.track
        )


def _row(edge: WalkEdge) -> MatchedPassage:
    """Return the record of a passage that an entry may continue."""
    source_step = edge.source
    t = source_step.t if edge.slot or source_step.exit_t is None else source_step.exit_t
    return MatchedPassage(source_step.camera, t, edge.probability, source_step.track)
