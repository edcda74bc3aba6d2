"""What one topology version says of exits, as arrays, prepared once and never changed.

A `PreparedVersion` finds the zone of an event and the `ExitTable` of a zone; `Predictor`,
`camtopod.client.Gate` and `Walks` over the same topology share it. All times inside are *corrected
times*: less the clock offset of the camera, as given in the topology.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from camtopod.arrays import Floats, Ints
from camtopod.codec import require_topology
from camtopod.columns import numbers
from camtopod.predict.anywhere import Anywhere
from camtopod.predict.contexts import ContextMultipliers
from camtopod.predict.hand_over import HandOver
from camtopod.predict.hazards import Hazards, model_of
from camtopod.predict.labels import Labels
from camtopod.predict.outcomes import Outcomes
from camtopod.predict.passages import Passage
from camtopod.predict.time_windows import PaceModel
from camtopod.predict.zone_lookup import ZoneLookup
from camtopod.records import Event, Topology
from camtopod.topology import UnknownPlace

LEARNED_EXITS = 100
"""Exits at a zone after which it is known where objects go, without any link: one that a tenth of
them takes would have the ten passages of a link.
"""


class ExitTable:
    """Figures of a topology version about objects that leave at one zone.

    zone: index of the zone.
    outcomes: its outcomes.
    """

    def __init__(self, version: PreparedVersion, zone: int, outcomes: Outcomes) -> None:
        self.zone = zone
        self.outcomes = outcomes
        self.target_cameras = version.camera_of[outcomes.targets]
        """(rows,) number of each target's camera."""
        self.transitions = outcomes.share * version.hazards.departures[zone]
        """(rows,) expected transitions that the hazards were learned from."""
        self.is_first = np.zeros(len(outcomes.targets), np.bool_)
        """(rows,) True for the first row of each target."""
        self.is_first[np.unique(outcomes.targets, return_index=True)[1]] = True
        self.masses = outcomes.hazard * version.hazards.bins.widths
        """(rows, bins) expected arrivals by lag bin, of an exposed departure."""

        # Clocks of the targets relative to that of this camera.
        offsets = version.offset_of[outcomes.targets] - version.offset_of[zone]
        self.report_shift = offsets + outcomes.delay
        """(rows, seconds) to be added to a lag to get the difference of the event times of exit
        and arrival, each by its camera's clock, after which an arrival counts as reported.
        """
        self.window_shift = np.where(version.is_corrected, 0.0, offsets) + outcomes.delay
        """(rows, seconds) to be added to a lag to get the lag that is published."""


class PreparedVersion:
    """A topology version in the form that prediction reads; zones are indices into ``zones``.

    The `ExitTable` of a zone is made at its first exit. It does not refer to the version: without
    reference cycles the memory of a version is free as soon as the version is no longer used.
    """

    def __init__(self, topology: Topology) -> None:
        """Prepare a topology. Raises ValueError for a city, whose parts predict; TypeError."""
        require_topology(topology)
        if topology.parts:
            raise ValueError("the topology is a city, which has parts: CityPredictor asks them")
        model = model_of(topology)
        self.number = topology.version
        self.as_of = topology.as_of
        self.zones = topology.zones
        self.zone_names = (
            np.array([zone.camera for zone in topology.zones], object),
            np.array([zone.id for zone in topology.zones], object),
        )
        """(zones,) camera and id of each zone."""
        self.hazards = Hazards(topology)
        self.labels = Labels(topology)
        self.contexts = ContextMultipliers(topology)
        self.paces = PaceModel(topology)
        self.hand_over = HandOver(topology)
        self._lookup = ZoneLookup(topology.zones)
        self._tables: dict[int, ExitTable] = {}

        # Clocks.
        self.is_corrected = model.clocks_corrected
        """True if published lags are between corrected times."""
        self.clock_offset = {camera.id: camera.clock_offset for camera in topology.cameras}
        """Clock offset of each camera, seconds."""
        offsets = self.clock_offset.values()
        self.offset_range = max(offsets, default=0.0) - min(offsets, default=0.0)
        """Largest difference between two clocks, seconds."""
        self.offset_of = self.hazards.offset_of
        """(zones, seconds) clock offset of each zone's camera."""

        # Cameras that have zones.
        self.cameras = self.hazards.cameras
        self.camera_of = self.hazards.camera_of
        """(zones,) number of each zone's camera."""
        shares = numbers(model.event_share, np.float32, len(topology.cameras)).astype(float)
        share = dict(zip(self.clock_offset, shares.tolist(), strict=True))
        self.event_share = np.array([share.get(camera, 0.0) for camera in self.cameras])
        """(cameras,) share of each camera in all events of the site."""
        self.anywhere = Anywhere(topology, self.hazards)

    @property
    def longest_lag(self) -> float:
        """Longest lag of the version, seconds: who is not seen by then has left."""
        return self.hazards.lag_max

    def longest_stays(self) -> dict[str, float]:
        """Return the longest known dwell time (seconds) by camera."""
        longest: dict[str, float] = {}
        for zone, stay in zip(self.zones, self.hazards.stay[:, -1].tolist(), strict=True):
            if stay:
                longest[zone.camera] = max(longest.get(zone.camera, 0.0), stay)
        return longest

    def require_camera(self, camera: str) -> None:
        """Raise `UnknownPlace` (a KeyError) for a camera that this version does not have."""
        if camera not in self.clock_offset:
            raise UnknownPlace("camera", camera, self.number, list(self.clock_offset))

    def zone_of(self, event: Event) -> int | None:
        """Return the zone (index) that an event belongs to; None if its camera has no zone."""
        return self._lookup.zone_of(event)

    def is_learned(self, zone: int) -> bool:
        """Return True if it is known where objects of a zone go, by links or as hardly any do."""
        is_linked = int(self.camera_of[zone]) in self.anywhere.neighbours
        return is_linked or self.hazards.departures[zone] >= LEARNED_EXITS

    def rates_in_view(
        self, passages: Sequence[Passage], zones: Ints, t: Floats, labels: Ints
    ) -> Floats:
        """Return the rates (n, m, 1/s) at which objects of n open passages arrive in other views; 0
        before their entries, and if these are unknown.

        zones, t, labels (m,): index of the zone, corrected time (seconds) and label of each of m
            arrivals.
        """
        entry = np.array([passage.entry for passage in passages], np.int32)[:, None]
        label = np.array([passage.label for passage in passages], np.int32)[:, None]
        since = t - np.array([passage.t for passage in passages])[:, None]
        rates = self.hazards.rates_before_exit(self.camera_of[entry], zones)
        rates += self.hazards.rates_entered(entry, zones, since)
        rates *= ((entry >= 0) & (since >= 0.0)) * self.labels.agreement(label, labels, zones)
        return rates

    def table(self, zone: int) -> ExitTable | None:
        """Return the table of a zone, given by its index; None if the zone has no targets."""
        if zone not in self._tables and (outcomes := self.hazards.outcomes(zone)) is not None:
            self._tables[zone] = ExitTable(self, zone, outcomes)
        return self._tables.get(zone)
