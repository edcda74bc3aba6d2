"""What an object is: the sightings of its track decide together whether it counts."""

from __future__ import annotations

from collections.abc import Collection

PARTS = {"head", "humanhead", "face", "humanface", "plate", "numberplate", "licenseplate"}
"""Kinds that are part of an object, as `plain` writes them.

They have tracks of their own: a person whose head is tracked too would count twice.
"""
Votes = int | None
"""Sightings of an object as a kind that counts, less the others; None while no kind is known."""


def vote(votes: Votes, kind: str, labels: Collection[str]) -> Votes:
    """Return the votes with one more sighting; one without a kind does not vote.

    labels: the kinds that count, as `plain` writes them; empty for all but `PARTS`.
    """
    name = plain(kind)
    if not name:
        return votes
    wanted = name in labels or (not labels and name not in PARTS)
    return (votes or 0) + (1 if wanted else -1)


def counts(votes: Votes, labels: Collection[str]) -> bool:
    """Return True if no majority is against it; of unknown kind it counts if all do."""
    return not labels if votes is None else votes >= 0


def plain(kind: str) -> str:
    """Return a kind in lower case without blanks and signs: ``License_Plate`` is a plate, too."""
    return "".join(filter(str.isalnum, kind.casefold()))
