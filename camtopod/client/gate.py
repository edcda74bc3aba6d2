"""Association priors for multi-camera tracking, from the learned topology.

An object that leaves a zone appears next at some zone after some lag, or is not seen again, as
predictions say (thesis 4.5, 4.6; `camtopod.predict.outlook`). An object that appears has left
another zone before, or comes from outside, at a constant rate. All values are logarithms:

    gate(...)      ln of 1/s   an object that left there appears next here at this time
    gate_new(...)  ln of 1/s   an object from outside appears here
    gate_gone(...) ln of 1     an object that left there is not seen again, or not yet

``gate - gate_new - gate_gone`` is the log odds that an exit and an entry belong to one object
rather than to two. `Gate.affinity` computes it for many, from links only: an appearance without
a link counts as leaving, and as an arrival from outside, except on a closed site. The matching with
the largest sum is the most likely of all.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from camtopod.arrays import Floats
from camtopod.codec import require_event
from camtopod.predict import (
    Departure,
    Outlook,
    Passage,
    PreparedVersion,
    log_density,
    outlook,
    outside_rates,
)
from camtopod.records import Event, Topology
from camtopod.topology import block_of, zone_at, zones_of


class Gate:
    """Association log-priors of one version of the topology. Immutable and thread-safe.

    Times are seconds since the epoch by the clock of the camera that reports the event; the
    version's clock offsets are applied. While little has been learned the odds are overconfident,
    as predictions are. No daemon is needed:

        >>> from camtopod import Event, Gate, load_topology
        >>> gate = Gate(load_topology("topology.json"))
        >>> exits = [Event("lobby", "exit", 1_700_000_000.0)]
        >>> entries = [Event("hall", "entry", 1_700_000_000.0 + lag) for lag in (2, 8)]
        >>> gate.affinity(exits, entries) > 0
        array([[False,  True]])
    """

    def __init__(self, topology: Topology, prepared: PreparedVersion | None = None) -> None:
        """Prepare the tables; ``prepared`` is the same topology, if it is prepared already."""
        self.topology = topology
        self.prepared = prepared or PreparedVersion(topology)
        self._outside = outside_rates(self.prepared)
        self._ahead = self.prepared.clock_offset

    def gate(
        self,
        from_zone: str,
        t_exit: float,
        to_camera: str,
        t_entry: float,
        to_zone: str | None = None,
    ) -> float:
        """Return ln of the density (1/s) of a transition that ends at a camera at ``t_entry``.

        The object left ``from_zone`` at ``t_exit`` and appears next at ``to_camera``, or only at
        its zone ``to_zone`` if given.

        from_zone, to_zone: ids of zones (``lobby/1``).
        t_exit, t_entry: seconds since the epoch, each by its own camera's clock. Where views
            overlap, ``t_entry`` may be before ``t_exit``.

        Integrated over ``t_entry`` the density is the probability of appearing there next. It is a
        step function, constant within a bin of some percent of the lag. At lags without a link it
        is the density of objects that may appear anywhere, or -inf if there are none.

        Raises ValueError for times that are not finite; `UnknownPlace` (a KeyError) for a zone or
        camera that this version does not have. Zones come and go with versions: for events prefer
        `affinity`, which finds zones by position.
        """
        source = self._zone(from_zone)
        zones = np.array(self._zones(to_camera, to_zone), np.intp)
        departure_t = t_exit - self._ahead[self.topology.zones[source].camera]
        lag = t_entry - self._ahead[to_camera] - departure_t
        if not math.isfinite(lag):
            raise ValueError(f"t_exit {t_exit} and t_entry {t_entry}: finite numbers of seconds")
        answer = outlook(self.prepared, Departure(source))
        density = log_density(self.prepared, answer, zones, np.full(len(zones), lag))
        return float(np.logaddexp.reduce(density))

    def gate_new(self, to_camera: str, to_zone: str | None = None) -> float:
        """Return ln of the rate (1/s) at which objects from outside appear at a camera or zone.

        Objects from outside have not left another zone before; false detections count among them.
        The rate is constant in time: the mean over the window that was learned from. Raises
        `UnknownPlace` (a KeyError).
        """
        return math.log(self._outside[self._zones(to_camera, to_zone)].sum())

    def gate_gone(self, from_zone: str, seconds: float = math.inf) -> float:
        """Return ln of the probability that an object is unseen ``seconds`` after leaving a zone.

        By default: that it is not seen again. Raises `UnknownPlace` (a KeyError); ValueError if
        ``seconds`` is NaN.
        """
        if math.isnan(seconds):
            raise ValueError("seconds is not a number")
        return _log_unseen(outlook(self.prepared, Departure(self._zone(from_zone))), seconds)

    def affinity(
        self, exits: Sequence[Event], entries: Sequence[Event], now: float | None = None
    ) -> Floats:
        """Return the log odds (exits, entries), in nats, that exit and entry belong to one object.

        The alternative is that they belong to two objects. Add the log likelihood ratios of other
        evidence, such as appearance, and match by

            rows, columns = scipy.optimize.linear_sum_assignment(np.maximum(odds, 0), maximize=True)

        Keep the pairs with odds above 0: this is the most likely matching as a whole.

        exits, entries: events as `TrackEvents` makes them, of all cameras, in any order. Zones are
            found by position. Include the entries of open tracks: if the entry of an exit's passage
            (same camera and track) is among the entries, the zone of entry and, where views
            overlap, the time since that entry improve the odds.
        now: corrected time (seconds) up to which entries are complete, so that objects still under
            way do not count as gone. Default: the newest of the given times.

        -inf means that no link has this lag; use ``np.maximum(odds, -20)`` if other evidence may
        overrule that. 0 means no information: a camera has no zone yet.

        Raises `UnknownPlace` (a KeyError) for a camera that this version does not have; ValueError
        for an entry among the exits, an exit among the entries, or an invalid time.
        """
        if now is not None and math.isnan(now):
            raise ValueError("now is not a number")
        for event in exits:
            require_event(event, "exit")
            self.prepared.require_camera(event.camera)
        for event in entries:
            require_event(event, "entry")
            self.prepared.require_camera(event.camera)

        # Zones and corrected times of the events.
        odds = np.zeros((len(exits), len(entries)))
        zones = [self.prepared.zone_of(entry) for entry in entries]
        columns = np.array([k for k, zone in enumerate(zones) if zone is not None], np.intp)
        if not len(columns):
            return odds
        to = np.array([zone for zone in zones if zone is not None], np.intp)
        entry_t = np.array([self._corrected(entries[k]) for k in columns])
        exit_t = [self._corrected(event) for event in exits]
        until = max([*exit_t, *entry_t.tolist()]) if now is None else now

        # Row of each exit: the transition against leaving the site and an arrival from outside.
        links_only = not self.prepared.anywhere.nobody_leaves
        new = np.log(self._outside)[to]
        labels = self.prepared.labels
        entry_labels = np.array([labels.number(entries[k].label) for k in columns])
        by_track = defaultdict(list)
        for candidate in entries:
            if candidate.track is not None:
                by_track[candidate.camera, str(candidate.track)].append(candidate)
        for row, event in enumerate(exits):
            zone = self.prepared.zone_of(event)
            if zone is not None:
                entry = _entry_of(event, by_track[event.camera, str(event.track)])
                passage = None if entry is None else self._passage(entry)
                block = block_of(event.x, event.y)
                answer = outlook(self.prepared, Departure(zone, exit_t[row], passage, block))
                lags = entry_t - exit_t[row]
                density = log_density(self.prepared, answer, to, lags, links_only)
                log_unseen = _log_unseen(answer, until - exit_t[row], links_only)
                odds[row, columns] = density - new - log_unseen
                label = labels.number(event.label or (entry or event).label)
                odds[row, columns] += np.log(labels.agreement(label, entry_labels, to))
        return odds

    def _corrected(self, event: Event) -> float:
        """Return the corrected time of an event."""
        return event.t - self._ahead[event.camera]

    def _passage(self, entry: Event) -> Passage | None:
        """Return the passage that begins with an entry; None if its zone is unknown."""
        zone = self.prepared.zone_of(entry)
        return None if zone is None else Passage(self._corrected(entry), entry.camera, zone)

    def _zones(self, camera: str, zone: str | None) -> list[int]:
        """Return the zones (indices) of a camera, or the one zone given."""
        if zone is not None:
            return [self._zone(zone, camera)]
        return zones_of(self.topology.version, self.topology.zones, camera)

    def _zone(self, zone: str, camera: str | None = None) -> int:
        """Return the index of a zone; with ``camera``, of one of its zones."""
        return zone_at(self.topology.version, self.topology.zones, zone, camera)


def _log_unseen(answer: Outlook, seconds: float, links_only: bool = False) -> float:
    """Return ln of the `Outlook.unseen` of some seconds after the exit."""
    return math.log(float(answer.unseen(np.array([seconds]), links_only)[0]))


def _entry_of(event: Event, entries: Sequence[Event]) -> Event | None:
    """Return the entry of an exit's passage: the latest before it of its track; None without one.

    entries: those of its track.
    """
    before = [entry for entry in entries if entry.t <= event.t]
    return max(before, key=lambda entry: entry.t, default=None)
