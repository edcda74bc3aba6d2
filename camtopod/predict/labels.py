"""How far two labels speak for one object, by a version of the topology.

The label of an object mostly persists from view to view (`camtopod.learn.traffic.labels`). So a
passage that has another label than an arrival is hardly its cause, and the rarer a common label is,
the likelier it is. Labels are numbers here: of those that the version knows, and -1 for all else.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from camtopod.arrays import Floats, Indices
from camtopod.columns import numbers
from camtopod.labels import plain
from camtopod.predict.hazards import model_of
from camtopod.records import Topology

Numbers = Indices | Sequence[int] | int
UNKNOWN_LABEL = -1
"""Number of a label that is not known, which fits all."""
SHARE_MIN = 1e-6
"""Least share of a label, as shares are rounded."""


class Labels:
    """The labels of a topology version; zones are indices into ``topology.zones``.

    names: the labels, by number.
    """

    def __init__(self, topology: Topology) -> None:
        label_model = model_of(topology).labels
        self.names = label_model.names if label_model else []
        self._number = {name: k for k, name in enumerate(self.names)}
        self._persistence = label_model.persistence if label_model else 0.0
        self._share = np.ones((len(topology.zones), len(self.names) + 1))
        """(zones, labels + 1) share of each label among the arrivals; the last is of unknown."""
        if label_model:
            shares = numbers(label_model.shares, np.float32, len(topology.zones), len(self.names))
            self._share[:, :-1] = np.maximum(shares, SHARE_MIN)

    def __bool__(self) -> bool:
        return bool(self.names)

    def number(self, label: str | None, without: int = UNKNOWN_LABEL) -> int:
        """Return the number of a label; `UNKNOWN_LABEL` for one that is not known.

        without: result for None, such as the number of the label of an exit's entry.
        """
        return self._number.get(plain(label), UNKNOWN_LABEL) if label else without

    def name(self, label: str | None) -> str | None:
        """Return a label as the version writes it; None if it does not know it."""
        number = self.number(label)
        return None if number == UNKNOWN_LABEL else self.names[number]

    def agreement(
        self, departure_label: Numbers, arrival_label: Numbers, zone: Numbers
    ) -> Floats | float:
        """Return the likelihood ratio (n,) of one object over two; 1.0 if there are no labels.

        departure_label, arrival_label (n,): labels of a passage and of an arrival.
        zone (n,): zone of the arrival.
        """
        if not self.names:
            return 1.0
        departure_label, arrival_label, zone = (
            np.asarray(departure_label),
            np.asarray(arrival_label),
            np.asarray(zone),
        )
        ratio = self._persistence * (departure_label == arrival_label) / self._share[
            zone, arrival_label
        ] + (1.0 - self._persistence)
        return np.where((departure_label >= 0) & (arrival_label >= 0), ratio, 1.0)

    def of_two(self, departure_label: int, arrival_label: int, zone: int) -> float:
        """Return the `agreement` of one passage and one arrival."""
        if departure_label < 0 or arrival_label < 0:
            return 1.0
        ratio = (
            self._persistence
            * (departure_label == arrival_label)
            / float(self._share[zone, arrival_label])
        )
        return ratio + 1.0 - self._persistence

    def moved(self, older: Labels) -> dict[int, int]:
        """Return the present number of each label of an older version, by its number there."""
        return {k: self.number(name) for k, name in enumerate(older.names)}
