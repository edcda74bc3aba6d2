"""What an object is: the sightings of its track decide together whether it counts."""

from __future__ import annotations

from collections.abc import Collection

from camtopod.labels import plain as plain

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
    return (votes or 0) + (1 if is_wanted(name, labels) else -1)


def is_wanted(kind: str, labels: Collection[str]) -> bool:
    """Return True for a kind that counts; ``labels`` as for `vote`."""
    name = plain(kind)
    return name in labels or (not labels and name not in PARTS)


def counts(votes: Votes, labels: Collection[str]) -> bool:
    """Return True if no majority is against it; of unknown kind it counts if all do."""
    return not labels if votes is None else votes >= 0
