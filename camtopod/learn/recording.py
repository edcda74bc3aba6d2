"""Learn from a recording in one call."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import PurePath

from camtopod.codec import time_of
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.records import Event, Topology


def learn_topology(
    events: Iterable[Event], settings: Settings | None = None, site: str = "site"
) -> Topology:
    """Learn the topology of a camera network from recorded events, in any order.

        >>> import random
        >>> from camtopod import Event, learn_topology
        >>> random.seed(1)
        >>> events, t = [], 1_700_000_000.0
        >>> for number in range(200):
        ...     t += random.expovariate(1 / 60)
        ...     events.append(Event("lobby", "exit", t, track=str(number)))
        ...     events.append(Event("hall", "entry", t + random.gauss(8, 1), track=str(number)))
        >>> [(link.from_, link.to) for link in learn_topology(events).links]
        [('lobby/1', 'hall/1')]

    The last window is learned in one fit, as `camtopod learn` does. Events that the learner does
    not take, such as duplicates, are left out. Raises ValueError if there are none; TypeError for
    other objects, such as the name of a file, which `load_events` reads.
    """
    if isinstance(events, (str, PurePath)):
        raise TypeError(f"{events!r:.100} is no list of events; load_events reads one from a file")
    return learn_in_order(sorted(events, key=time_of), settings, site)


def learn_in_order(
    events: Iterable[Event], settings: Settings | None = None, site: str = "site"
) -> Topology:
    """Learn as `learn_topology`, from events in order of time, which may be many."""
    learner = Learner(settings, site, "recording", only_last=True)
    for event in events:
        learner.receive(event)
    learner.flush()
    if learner.topology is None:
        raise ValueError("no events: nothing to learn from")
    return learner.topology
