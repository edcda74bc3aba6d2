"""What a weak link still lacks until it is published: passages, and the time they take at this
traffic.

The rule for publishing asks for a certain evidence (`significance`), and each further passage adds
about as much as the earlier ones did. Held-out evidence (`crossfit`) counts for the rule. It starts
late, as a link has to be learned before it can predict anything, so the evidence per passage is
estimated from the fit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camtopod.arrays import Floats, rows_at
from camtopod.learn.links.link_table import TRANSITIONS_MIN, LinkTable
from camtopod.learn.links.significance import ratio_needed
from camtopod.learn.settings import Settings

PASSAGES_MIN = 1.0
"""Fewest passages that an unpublished link is said to lack."""


class Lacking(NamedTuple):
    """Of each weak link, (L,): further passages, and seconds until they have been. NaN where
    waiting does not help.
    """

    passages: Floats
    seconds: Floats


def lacking(
    weak: LinkTable,
    between: LinkTable,
    published: int,
    zones: int,
    seconds: float,
    settings: Settings,
) -> Lacking:
    """What each of the ``weak`` links (L,) lacks.

    Args:
        weak: the weak links, with the evidence in the fit.
        between: pairs of zones with the held-out evidence; a weak link that is not among them has none.
        published: the number of links that meet the rule already.
        zones: the number of zones.
        seconds: how long the events of the window took.
    """
    needed = ratio_needed(published + 1, zones * zones, settings.publish_q_max)
    key, known = (table.source.astype(np.int64) * zones + table.target for table in (weak, between))
    at, tested = rows_at(known, key)
    held_out = np.zeros(len(key))
    held_out[tested] = between.ratio[at[tested]]

    # A passage brings as much evidence as those so far; a share that is too small stays so, however
    # many come.
    transitions = weak.transit.total
    each = weak.ratio / np.maximum(transitions, 1e-9)
    helps = (each > 0) & (weak.probability >= settings.publish_probability_min)
    passages = np.full(len(key), np.nan)
    passages[helps] = (needed - held_out[helps]) / each[helps]
    passages = np.maximum(passages, np.maximum(TRANSITIONS_MIN - transitions, PASSAGES_MIN))
    return Lacking(passages, passages * seconds / np.maximum(transitions, 1e-9))
