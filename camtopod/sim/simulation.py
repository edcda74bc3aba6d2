"""Simulation of a camera network: walkers, the events the cameras report, and the ground truth.

It is pure: the same settings give the same events. Walkers arrive as a Poisson process, follow a
first-order Markov chain over zones, and each keeps a speed of their own.
"""

from __future__ import annotations

import msgspec
import numpy as np
from msgspec.structs import replace

from camtopod.arrays import Longs
from camtopod.records import Event
from camtopod.sim.layout import make_layout, with_doors, without_paths
from camtopod.sim.reports import report, truth_of
from camtopod.sim.settings import SimSettings as SimSettings
from camtopod.sim.truth import Truth
from camtopod.sim.walkers import walk

ROUNDING = 1e-9
"""By how much shares that make 1 may exceed it."""


def simulate(settings: SimSettings) -> tuple[list[Event], Truth]:
    """Return events sorted by time, and the ground truth. Raises ValueError for invalid
    settings.
    """
    try:
        msgspec.convert(msgspec.structs.asdict(settings), SimSettings)
    except msgspec.ValidationError as error:
        raise ValueError(str(error)) from None

    # The network.
    structure, chance = (np.random.default_rng((settings.seed, part)) for part in (1, 2))
    layout = make_layout(settings.cameras, structure, settings.overlap_share)
    layout = with_doors(layout, settings.doors_closed, settings.doors_opened, structure)
    if not settings.linked:
        layout = without_paths(layout)

    # The walks, and what is recorded of them.
    passages = walk(layout, settings, chance)
    walkers = int(passages.walker.max(initial=-1)) + 1
    chance.random(walkers)  # this and the next two are not used: a seed keeps its events
    chance.integers(1, 4, walkers)
    chance.random(3 * walkers)
    passages = passages.take((passages.t_in >= 0) & (passages.t_out < settings.hours * 3600.0))
    recorded_passages = passages.take(chance.random(len(passages.t_in)) >= settings.missed)
    events, owners = report(recorded_passages, layout, settings, chance)
    events = _labelled(events, owners[:, 0], settings)
    return events, truth_of(layout, settings, recorded_passages, owners)


def _labelled(events: list[Event], walker: Longs, settings: SimSettings) -> list[Event]:
    """Return the events with the labels of their walkers; clutter has none.

    walker (events,): number of each event's walker, negative for clutter.
    """
    if not settings.labels:
        return events
    if sum(settings.labels.values()) > 1.0 + ROUNDING:
        raise ValueError("the shares of the labels are more than 1 together")
    limits = np.cumsum(list(settings.labels.values()))
    names = [*settings.labels, None]
    draws = np.random.default_rng((settings.seed, 3)).random(int(walker.max(initial=-1)) + 1)
    label_numbers = np.append(np.searchsorted(limits, draws, side="right"), len(limits))
    return [
        replace(event, label=names[k])
        for event, k in zip(events, label_numbers[np.maximum(walker, -1)].tolist(), strict=True)
    ]
