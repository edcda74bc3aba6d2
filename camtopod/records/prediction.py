"""Predictions of where an object appears next, and matches of an entry with earlier passages."""

from __future__ import annotations

import warnings

from msgspec import Struct

from camtopod import words


class NextCamera(Struct, frozen=True, omit_defaults=True):
    """One possible next appearance of an object that has left a view.

    q10, q50, q90 (seconds after the exit): the object appears earlier in 10, 50 and 90 % of cases.
    prior: True if these are guesses, as too few such objects have been seen.
    """

    camera: str
    zone: str
    probability: float
    q10: float
    q50: float
    q90: float
    prior: bool = False

    @property
    def when(self) -> str:
        """When it appears, in words; where views overlap it may have done so before the exit."""
        return words.when(self)


class Look(Struct, frozen=True):
    """Probability that a camera sees the object when it exits or, if none does, sees it next."""

    camera: str
    probability: float


class InView(Struct, frozen=True):
    """A passage under way in another view that may be of the object that left.

    since: time when the passage began.
    """

    camera: str
    track: str
    since: float
    probability: float


class Prediction(Struct, frozen=True, omit_defaults=True):
    """Where an object that has left the view of ``camera`` at ``t`` appears next.

        >>> from camtopod import Event, Predictor, load_topology
        >>> predictor = Predictor(load_topology("topology.json"))
        >>> prediction = predictor.predict(Event("lobby", "exit", 1_700_000_000.0))
        >>> prediction.next[0].camera, prediction.next[0].when
        ('hall', 'in 6 to 10 s')
        >>> print(prediction)
        hall 98 %, in 6 to 10 s; leaves the site 2 %

    zone: zone where it left; None if the camera has no zone yet.
    version: version of the topology that was used.
    leave: probability that it leaves the site; with those of ``next``, and with ``others`` if
        that is there, it sums to 1.
    next: possible next appearances, by falling probability; a zone may be there more than once, for
        other times.
    look, in_view: only if other views overlap: cameras that may see the object now or next, whose
        probabilities may sum to more than 1, and passages under way that may be of it.
    others: sum of the probabilities that are left out of ``next``; None if it has all.
    prior: True if it is not learned yet where objects of the zone go.
    """

    camera: str
    zone: str | None
    t: float
    track: str | None
    version: int
    leave: float
    next: list[NextCamera]
    look: list[Look] | None = None
    in_view: list[InView] | None = None
    others: float | None = None
    prior: bool = False

    @property
    def candidates(self) -> list[NextCamera]:
        """Earlier name of ``next``."""
        warnings.warn("Prediction.candidates is next", DeprecationWarning, stacklevel=2)
        return self.next

    def __str__(self) -> str:
        return words.headline(self).words


class MatchedPassage(Struct, frozen=True, omit_defaults=True):
    """An earlier passage that an entry may continue.

    t: time of its exit or, while it is under way, of its entry.
    """

    camera: str
    t: float
    probability: float
    track: str | None = None


class Match(Struct, frozen=True, omit_defaults=True, rename={"from_": "from"}):
    """Which earlier passages the entry at ``camera`` and ``t`` may continue.

    version: version of the topology that was used.
    from_: the passages, by falling probability; with ``new`` they sum to 1. The JSON key is
        ``from``.
    new: probability that it continues none of them.
    walk: name of the walk it belongs to: camera and time of its oldest passage of the
        last hour.
    """

    camera: str
    t: float
    version: int
    from_: list[MatchedPassage]
    new: float
    walk: str
    track: str | None = None

    def __str__(self) -> str:
        return words.origin(self)
