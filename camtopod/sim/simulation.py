"""Simulation of a camera network: walkers, the events the cameras report, and the ground truth.

It is pure: the same settings give the same events. Walkers arrive as a Poisson process, follow a
first-order Markov chain over zones, and each keeps a speed of their own; the disturbances of real
installations are settings.
"""

from __future__ import annotations

import numpy as np

from camtopod.records import Event
from camtopod.sim.faults import make_setup
from camtopod.sim.reports import report, truth_of
from camtopod.sim.settings import SimSettings, check
from camtopod.sim.truth import Truth
from camtopod.sim.walkers import walk, with_companions

__all__ = ["SimSettings", "simulate"]


def simulate(settings: SimSettings) -> tuple[list[Event], Truth]:
    """Return events sorted by time, and the ground truth. Raises ValueError for invalid
    settings.
    """
    check(settings)
    structure, chance = (np.random.default_rng((settings.seed, part)) for part in (1, 2))
    setup = make_setup(settings, structure)
    passages = with_companions(walk(setup, settings, chance), settings, chance)
    seconds = settings.hours * 3600.0
    passages = passages.take((passages.t_in >= 0) & (passages.t_out < seconds))
    recorded = passages.take(chance.random(len(passages.t_in)) >= settings.missed)
    events, owners = report(recorded, setup, settings, chance)
    return events, truth_of(setup, settings, recorded, owners)
