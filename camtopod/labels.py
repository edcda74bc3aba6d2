"""What an object is, as a word: the class that a detector or a camera gives it."""

from __future__ import annotations

import functools

LABELS_MAX = 32
"""Most labels of a site that count, the most frequent."""
LABEL_CHARACTERS_MAX = 64
"""Longest label."""
LABELS_PER_OBJECT_MAX = 8
"""Labels of one object that are counted; no detector changes its mind as often."""


@functools.lru_cache(1024)
def plain(label: str) -> str:
    """Return a label in lower case without blanks and signs: ``License_Plate`` is a plate, too."""
    return "".join(filter(str.isalnum, label.casefold()))


def count_label(counts: dict[str, int], label: str) -> None:
    """Count a sighting of an object as ``label``; an empty or an overlong one does not count."""
    name = plain(label) if len(label) <= LABEL_CHARACTERS_MAX else ""
    if name and (name in counts or len(counts) < LABELS_PER_OBJECT_MAX):
        counts[name] = counts.get(name, 0) + 1


def most_frequent(counts: dict[str, int]) -> str | None:
    """Return the label with the most sightings, the first by name of several; None without any."""
    return min(counts, key=lambda label: (-counts[label], label), default=None)
