"""The graph on which walks are matched: passages, and edges to the entries that may continue them.

At most one of the claims on a passage is right, and each entry has one cause. `pass_messages`
estimates the probability of each edge by the sum-product approximation (`walks`). The learner's
(`camtopod.learn.association.sum_product`) answers all arrivals of a window at once; here the few
entries that compete take turns, each with the newest messages, beside claims that stay as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

SWEEPS = 3
"""Sweeps of messages over the entries that compete."""


class WalkStep:
    """A passage as a step of a walk.

    camera, track: as in its events; track None if they have none.
    t (seconds): time of its entry by the camera's clock; of its exit if the entry is unknown.
    name: name of the walk that it would begin.
    entry: index of the zone of entry; None if unknown.
    entry_t (seconds): corrected time of the entry.
    """

    def __init__(
        self, camera: str, track: str | None, t: float, name: str, entry: int | None, entry_t: float
    ) -> None:
        self.camera = camera
        self.track = track
        self.label: str | None = None
        """Class of the object; None if unknown."""
        self.t = t
        self.name = name
        self.entry = entry
        self.entry_t = entry_t
        self.before: WalkStep | None = None
        """The passage that it continues; None if it begins a walk."""
        self.is_forgotten = False
        self.edges: list[WalkEdge] = []
        """Edges from the passages that it may continue."""
        self.outside = 0.0
        """Rate at which objects from outside enter where it does, 1/s."""
        self.is_final = False
        """True if its match does not change any more."""
        self.claims: dict[str, Claims] = {}
        """By the entries that may continue it: by their camera while in view, "" afterwards."""

        # The exit.
        self.exit_t: float | None = None
        """Time of the exit by the camera's clock; None while the object is in view."""
        self.departure_t = entry_t
        """Corrected time of the exit, seconds."""
        self.zone = -1
        """Index of the zone of exit."""
        self.block: int | None = None
        """Block of the image where the object left."""
        self.expected: ExitOutlook | None = None
        """Outlook after the exit; None until the first candidate needs it."""

    def begin_as(self, step: WalkStep) -> None:
        """Take the entry of another step; this one was known by its exit alone."""
        self.t, self.name, self.entry, self.entry_t = step.t, step.name, step.entry, step.entry_t
        self.expected = None

    @property
    def walk(self) -> str:
        """Name of its walk: that of the oldest passage before it that is remembered."""
        step = self
        while step.before is not None and not step.before.is_forgotten:
            step = step.before
        return step.name


class ExitOutlook(NamedTuple):
    """Where and when the object of an exit is likely to be seen again.

    scale (rows,): factor on the hazards of the zone of exit, by the context.
    no_arrival (bins + 1): probability of not having been seen again by each edge of the lag bins.
    rates (zones, 1/s): rates of appearing after no particular lag; None for 0.

    There are many, and the garbage collector need not look at tuples of numbers.
    """

    scale: tuple[float, ...]
    no_arrival: tuple[float, ...]
    rates: tuple[float, ...] | None


class Claims:
    """The claims on a passage of which at most one is right.

    edges: the edges to the entries that may continue it.
    odds: the sum of their claims, each the weight of the edge times its message.
    """

    def __init__(self) -> None:
        self.edges: list[WalkEdge] = []
        self.odds = 0.0


NO_CLAIMS = Claims()
"""Those on a passage that no entry claims; never changed."""


class WalkEdge:
    """An entry, and an earlier passage that it may continue.

    slot: key of `WalkStep.claims`.
    weight: rate at which the passage would cause the entry, 1/s.
    """

    def __init__(self, source: WalkStep, entry: WalkStep, slot: str, weight: float) -> None:
        self.source = source
        self.entry = entry
        self.slot = slot
        self.weight = weight
        self.claims = source.claims.get(slot, NO_CLAIMS)
        """The claims that compete with it for the passage, and its own once it is added."""
        self.message = 1.0 / entry.outside
        """Sum-product message from the entry, s."""
        self.probability = 0.0
        self.match_probability = 0.0
        """The probability when the match of the entry was given."""

    def add(self) -> None:
        """Add the edge to its entry, and its claim to those on the passage."""
        self.claims = self.source.claims.setdefault(self.slot, Claims())
        self.entry.edges.append(self)
        self.claims.edges.append(self)
        self.claims.odds += self.weight * self.message


def pass_messages(entries: Sequence[tuple[WalkStep, Sequence[tuple[WalkEdge, float]]]]) -> None:
    """Update messages and probabilities of the edges of entries that compete.

    entries: the entries, each with its edges; each edge with the odds that its passage has no
        successor.
    """
    for _ in range(SWEEPS):
        for entry, edges in entries:
            offers = [
                edge.weight / (unclaimed_odds + edge.claims.odds - edge.weight * edge.message)
                for edge, unclaimed_odds in edges
            ]
            total = entry.outside + sum(offers)
            for (edge, _), offer in zip(edges, offers, strict=True):
                message = 1.0 / (total - offer)
                edge.claims.odds += edge.weight * (message - edge.message)
                edge.message = message
                edge.probability = offer / total
