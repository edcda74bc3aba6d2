"""What an object is: the sightings of its track decide together whether it counts."""

from __future__ import annotations

from collections.abc import Collection

from msgspec import Struct

PARTS = frozenset(
    {"head", "humanhead", "face", "humanface", "plate", "numberplate", "licenseplate"}
)
"""Kinds that are part of an object, as `plain` writes them.

They have tracks of their own: a person whose head is tracked too would count twice.
"""


class Votes(Struct):
    """Sightings of an object by what they take it for: trackers change their mind about a kind."""

    wanted: int = 0
    unwanted: int = 0

    def add(self, kind: str, labels: Collection[str]) -> None:
        """Count a sighting; one without a kind does not vote.

        labels: the wanted kinds, as `plain` writes them; empty for all but `PARTS`.
        """
        name = plain(kind)
        if not name:
            return
        if name in labels or (not labels and name not in PARTS):
            self.wanted += 1
        else:
            self.unwanted += 1

    def verdict(self) -> Votes:
        """Return what they say as one vote, which later ones outweigh; none if they are none."""
        wanted = self.known() and self.wanted >= self.unwanted
        return Votes(int(wanted), int(self.wanted < self.unwanted))

    def known(self) -> bool:
        """Return True if a sighting had a kind."""
        return self.wanted + self.unwanted > 0

    def count(self, labels: Collection[str]) -> bool:
        """Return True if the object counts: no majority is against it.

        One of unknown kind counts unless kinds are wanted.
        """
        return self.wanted >= self.unwanted and (self.known() or not labels)


def plain(kind: str) -> str:
    """Return a kind in lower case without blanks and signs: ``License_Plate`` is a plate, too."""
    return "".join(filter(str.isalnum, kind.casefold()))
