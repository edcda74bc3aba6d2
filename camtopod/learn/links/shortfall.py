"""Shortfall of weak links: the passages each lacks until it is published, and how long they take.

The rule for publishing asks for a certain evidence (`significance`), and each further passage adds
about as much as the earlier ones did. Held-out evidence (`cross_validation`) counts for the rule.
It starts late, as a link has to be learned before it can predict anything, so the evidence per
passage is estimated from the fit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camtopod.arrays import Floats, find_rows
from camtopod.learn.links.link_table import TRANSITIONS_MIN, LinkTable
from camtopod.learn.links.significance import ratio_needed
from camtopod.learn.settings import Settings

PASSAGES_MIN = 1.0
"""Least number of passages that an unpublished link lacks."""


class LinkShortfall(NamedTuple):
    """Shortfall of weak links, (L,) each; nan where waiting does not help."""

    passages: Floats
    """Further passages needed."""
    seconds: Floats
    """Time until they have happened, at the present traffic."""


def shortfall_of(
    weak: LinkTable,
    between: LinkTable,
    published: int,
    zones: int,
    seconds: float,
    settings: Settings,
) -> LinkShortfall:
    """Return the shortfall of each weak link.

    weak: the weak links (L,), with the evidence in the fit.
    between: pairs of zones with the held-out evidence; weak links that are not among them have
        none.
    published: number of links that meet the rule already.
    zones: number of zones.
    seconds: duration of the window.
    """
    # Evidence needed for the next link, and held-out evidence so far.
    needed = ratio_needed(published + 1, zones * zones, settings.publish_q_max)
    key, known = (table.source.astype(np.int64) * zones + table.target for table in (weak, between))
    at, tested = find_rows(known, key)
    held_out = np.zeros(len(key))
    held_out[tested] = between.ratio[at[tested]]

    # Each passage is taken to add the mean evidence of those so far. A share below the limit for
    # publishing stays so with any number of passages.
    transitions = weak.transit.total
    each = weak.ratio / np.maximum(transitions, 1e-9)
    helps = (each > 0) & (weak.probability >= settings.publish_probability_min)
    passages = np.full(len(key), np.nan)
    passages[helps] = (needed - held_out[helps]) / each[helps]
    passages = np.maximum(passages, np.maximum(TRANSITIONS_MIN - transitions, PASSAGES_MIN))
    return LinkShortfall(passages, passages * seconds / np.maximum(transitions, 1e-9))
