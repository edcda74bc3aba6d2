"""Shortfall of weak links: how many more objects must take a link until it is published.

`shortfall_of` estimates this number for each weak link (one that is likely but not published), and
how long it takes. The rule for publishing asks for a certain evidence (`significance`), and each
further object on the link is taken to add as much evidence as the earlier objects did on average.
The evidence that counts for the rule is held-out (`cross_validation`). It starts late, as a link
has to be learned before it can predict anything, so the evidence per object is estimated from the
fit instead.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camtopod.arrays import Floats
from camtopod.learn.links.link_table import TRANSITIONS_MIN, LinkTable
from camtopod.learn.links.significance import ratio_needed
from camtopod.learn.settings import Settings


class LinkShortfall(NamedTuple):
    """Shortfall of L weak links, (L,) each; nan for links that more traffic does not publish."""

    passages: Floats
    """Number of further objects that must take the link."""
    seconds: Floats
    """Seconds until these objects have taken the link, at the traffic of the window."""


def shortfall_of(
    weak: LinkTable,
    between: LinkTable,
    published: int,
    zones: int,
    seconds: float,
    settings: Settings,
) -> LinkShortfall:
    """Return the shortfall of each weak link.

    weak: the L weak links, with the evidence of the fit.
    between: pairs of zones with held-out evidence; a weak link that is not among them has none.
    published: number of links that meet the rule already.
    zones: number of zones.
    seconds: duration of the window.
    """
    # Evidence needed for the next link, and held-out evidence so far.
    usual = ratio_needed(published + 1, zones * zones, settings.publish_q_max)
    needed = usual - np.log(weak.weight)
    held_out = between.evidence_of(weak.source, weak.target)

    # Each further object adds the mean evidence of the transitions so far. A link whose share is
    # below the limit for publishing is not published with any number of objects.
    transitions = weak.transit.total
    each = weak.ratio / np.maximum(transitions, 1e-9)
    helps = (each > 0) & (weak.probability >= settings.publish_probability_min)
    passages = np.full(len(held_out), np.nan)
    passages[helps] = (needed - held_out)[helps] / each[helps]
    passages = np.maximum(passages, np.maximum(TRANSITIONS_MIN - transitions, 1.0))
    return LinkShortfall(passages, passages * seconds / np.maximum(transitions, 1e-9))
