"""Labels of objects, such as ``person`` or ``car``, and how far they persist from view to view.

A label says what an object is. Two events of one object mostly have one label, but a detector may
err, and two cameras may use different words. So of the transitions, a share `persistence` keeps the
label, and the label of the others is as that of any arrival at the zone:

    P(b | a, one object) = persistence (a = b) + (1 - persistence) P(b at the zone)

Over P(b at the zone) this is a likelihood ratio of one object over two. It is 1 where a label is
unknown, or all objects have the same; the rarer a label is, the more it tells.
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Bools, Floats, Ints, Singles

ZONE_ARRIVALS = 10.0
"""Weight of the shares of labels at the whole site in those at a zone, in arrivals."""
PRIOR_TRANSITIONS = (9.0, 1.0)
"""Transitions that keep their label, and that do not, before any is seen: a detector that calls one
object in ten otherwise is a poor one.
"""
PERSISTENCE_MAX = 0.999
"""Largest persistence: any detector errs at times."""
HALVINGS = 20
"""Steps of the estimate of persistence, each of which halves its error."""
RATIO_MAX = 10.0
"""Largest ratio in the weights of first hazards, as one coincidence of rare labels proves little.
"""


def label_shares(zone: Ints, label: Ints, zones: int) -> Floats:
    """Return the share (n,) of each arrival's label among the arrivals at its zone.

    zone (n,): zone of each arrival.
    label (n,): number of its label; -1 without one, and the result is 1.
    """
    share = label_table(zone, label, zones, int(label.max(initial=0)) + 1)
    return np.where(label >= 0, share[zone, np.maximum(label, 0)], 1.0)


def label_table(zone: Ints, label: Ints, zones: int, labels: int) -> Floats:
    """Return the share of each label among the labelled arrivals at each zone, (zones, labels).

    zone, label (n,): as for `label_shares`.
    """
    mask = label >= 0
    counts = np.zeros((zones, labels))
    np.add.at(counts, (zone[mask], label[mask]), 1.0)
    of_site = counts.sum(axis=0) / max(counts.sum(), 1.0)
    of_zone = counts.sum(axis=1, keepdims=True)
    table: Floats = (counts + ZONE_ARRIVALS * of_site) / (of_zone + ZONE_ARRIVALS)
    return table


def label_agreement(
    departure_label: Ints, arrival_label: Ints, share: Floats, persistence: float
) -> Floats:
    """Return the likelihood ratio (M,) of one object over two, by the labels of two events.

    departure_label, arrival_label (M,): labels of a departure and of an arrival. If either is
        unknown, the ratio is 1.
    share (M,): share of the arrival's label among the arrivals at its zone.
    """
    ratio: Floats = 1.0 - persistence + persistence * (departure_label == arrival_label) / share
    return np.where((departure_label >= 0) & (arrival_label >= 0), ratio, 1.0)


def estimate_label_persistence(like: Bools, share: Floats, responsibility: Floats) -> float:
    """Return the likeliest persistence of labels, from M candidates whose labels are known.

    like (M,): True for candidates whose two labels are the same.
    share (M,): as for `label_agreement`.
    responsibility (M,): probability, whatever the labels, that the candidate is of one object.
    """
    # The log likelihood is concave: halve the range in which its slope is 0.
    slope = responsibility * (like / share - 1.0)
    same_count, other_count = PRIOR_TRANSITIONS
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        total = float((slope / (1.0 + middle * slope)).sum())
        total += same_count / middle - other_count / (1.0 - middle)
        low, high = (middle, high) if total > 0.0 else (low, middle)
    return min(high, PERSISTENCE_MAX)


def first_weights(likeness: Singles, share: Floats, persistence: float) -> tuple[Singles, float]:
    """Return the weight (M,) of each candidate in a lag histogram, and the mean of unrelated ones.

    likeness (M,): `label_agreement` of the candidates.
    share (m,): as for `label_agreement`, of all arrivals.

    A transition has a mean weight of 1, so the histogram is an estimate of as many transitions as
    without labels, and chance adds less to it.
    """
    like = 1.0 - persistence + persistence / share
    mean_weight = persistence * float(np.minimum(like, RATIO_MAX).mean()) + 1.0 - persistence
    weight: Singles = (np.minimum(likeness, RATIO_MAX) / mean_weight).astype(np.float32)
    return weight, 1.0 / mean_weight
