"""Real recordings with identities: true passages and links, and what the events can tell.

A recording is a folder with ``events.jsonl`` and ``identities.csv`` (track, identity). Identities
are used for scoring; the learner never sees them. An identity's passages are ordered by entry, exit
and camera; the passage after one is its true next appearance.
"""

from __future__ import annotations

import csv
from collections import Counter, defaultdict
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from camtopod.arrays import Floats
from camtopod.codec import event_from_json
from camtopod.records import Event

CameraPair = tuple[str, str]
"""Two cameras: of departure and of arrival."""

TRAIN_SHARE = 0.7
"""Share of the events before the cut; exits in the rest are predicted."""
WINDOW_SECONDS_MAX = 180.0
"""Lag window of an exit, seconds (or a tenth of the recording); exits count when it is over."""
REACH_SECONDS = 180
"""Time after an exit in which every camera is searched, second by second."""
TRANSITIONS_MIN, TRANSITIONS_SHARE_MIN = 5, 0.03
"""Least transitions of a true link, and least share of all transitions from its camera."""
SPURIOUS_TRANSITIONS_MAX = 2
"""Most true transitions of a false link.

A published link with more, which is no true link, is neither right nor false.
"""


class Passage(Struct, eq=False):
    """One identity in one view, from entry to exit (event times), and its next passage, if any."""

    track: str
    camera: str
    begin: float
    end: float
    next_: Passage | None = None

    @property
    def lag(self) -> float:
        """Seconds from the exit to the next passage; negative where views overlap."""
        return float("nan") if self.next_ is None else self.next_.begin - self.end


class Recording(Struct):
    """A recording, cut in two."""

    name: str
    events: list[Event]
    """Events by time."""
    passages: dict[str, Passage]
    """Passages by track."""
    by_identity: list[list[Passage]]
    """Passages of each identity, in order."""
    cut: float
    """Event time of the cut; earlier events are learned."""
    end: float
    window: float
    """Lag window of an exit, seconds."""
    stretch: float = 1.0
    """By what all times were multiplied, and with them `WINDOW_SECONDS_MAX` and `REACH_SECONDS`."""

    @property
    def reach(self) -> int:
        """Time after an exit in which every camera is searched, seconds."""
        return round(self.stretch * REACH_SECONDS)

    @property
    def cameras(self) -> list[str]:
        """Names of the cameras, sorted."""
        return sorted({event.camera for event in self.events})

    def transitions(self) -> dict[CameraPair, list[float]]:
        """Return the lags of transitions that end before the cut, by camera pair."""
        lags: dict[CameraPair, list[float]] = defaultdict(list)
        for passage in self.passages.values():
            next_passage = passage.next_
            if (
                next_passage is not None
                and next_passage.camera != passage.camera
                and next_passage.begin < self.cut
            ):
                lags[passage.camera, next_passage.camera].append(passage.lag)
        return dict(lags)

    def links(self) -> dict[CameraPair, list[float]]:
        """Return the true links between cameras, with the lags of their transitions."""
        lags = self.transitions()
        exits = Counter[str]()
        for (source, _), times in lags.items():
            exits[source] += len(times)
        least = {
            pair: max(TRANSITIONS_MIN, TRANSITIONS_SHARE_MIN * exits[pair[0]]) for pair in lags
        }
        return {pair: times for pair, times in lags.items() if len(times) >= least[pair]}

    def in_view(self) -> dict[str, set[str]]:
        """Return by track the other cameras that see the identity at the end of the passage.

        If there is none, it is the next camera that does.
        """
        cameras: dict[str, set[str]] = {}
        for passages in self.by_identity:
            for passage in passages:
                elsewhere = [p for p in passages if p.camera != passage.camera]
                now = {p.camera for p in elsewhere if p.begin <= passage.end < p.end}
                later = [p for p in elsewhere if p.begin >= passage.end]
                first = min(later, key=lambda p: (p.begin, p.end, p.camera), default=None)
                cameras[passage.track] = now or ({first.camera} if first else set())
        return cameras

    def under_way(self) -> dict[str, set[str]]:
        """Return by track the identity's tracks that other cameras see at the end of
        the passage.
        """
        return {
            passage.track: {
                p.track
                for p in passages
                if p.camera != passage.camera and p.begin <= passage.end < p.end
            }
            for passages in self.by_identity
            for passage in passages
        }


def load(folder: Path, stretch: float = 1.0) -> Recording:
    """Read a recording.

    stretch: factor by which all times and stays grow, as on a larger site.

    Raises OSError if a file is missing, `camtopod.codec.Rejected` if a line is no event.
    """
    with (folder / "events.jsonl").open("rb") as lines:
        events = sorted((event_from_json(line) for line in lines), key=lambda event: event.t)
    if stretch != 1.0:
        first = events[0].t
        events = [replace(event, t=first + stretch * (event.t - first)) for event in events]
    with (folder / "identities.csv").open(newline="") as rows:
        identity = {row["track"]: row["identity"] for row in csv.DictReader(rows)}
    cut, end = events[int(TRAIN_SHARE * len(events))].t, events[-1].t

    # Passages from the events of each track.
    passages: dict[str, Passage] = {}
    for event in events:
        track = str(event.track)
        passage = passages.setdefault(track, Passage(track, event.camera, event.t, event.t))
        if event.kind == "entry":
            passage.begin = event.t
        else:
            passage.end = event.t
    return Recording(
        folder.name,
        events,
        passages,
        _in_order(passages, identity),
        cut,
        end,
        min(stretch * WINDOW_SECONDS_MAX, (end - events[0].t) / 10),
        stretch,
    )


def _in_order(passages: dict[str, Passage], identity: dict[str, str]) -> list[list[Passage]]:
    """Return each identity's passages in order, each with its next one."""
    groups: dict[str, list[Passage]] = defaultdict(list)
    for track, passage in passages.items():
        groups[identity[track]].append(passage)
    for group in groups.values():
        group.sort(key=lambda passage: (passage.begin, passage.end, passage.camera, passage.track))
        for passage, next_passage in pairwise(group):
            passage.next_ = next_passage
    return list(groups.values())


def tellable(
    recording: Recording, low: float = -60.0, high: float = 600.0
) -> dict[CameraPair, float]:
    """Return the evidence in the events for each true link, nats.

    It is the log likelihood ratio of the link's arrivals with and without it, where every kernel is
    made of the true lags. A kernel is Gaussian around each lag, ``low`` to ``high`` seconds;
    arrivals from outside come at the local rate times their true share; correspondences are shared
    by a few sweeps of a one-to-one assignment. As it is in sample, the estimate is generous. All
    times are before the stretch: a slow site tells as much as the same site at speed.
    """
    lags = {
        pair: [lag / recording.stretch for lag in times]
        for pair, times in recording.transitions().items()
    }
    true = recording.links()
    history = [passage for passage in recording.passages.values() if passage.end < recording.cut]
    names = sorted({passage.camera for passage in history})
    number = {name: k for k, name in enumerate(names)}
    camera = np.array([number[passage.camera] for passage in history])
    begin = np.array([passage.begin for passage in history]) / recording.stretch
    end = np.array([passage.end for passage in history]) / recording.stretch
    passages = np.bincount(camera, minlength=len(number))

    # Arrivals by time, and their rate from outside.
    order = np.argsort(begin, kind="stable")
    at, arrival_camera = begin[order], camera[order]
    arrivals_of = [np.flatnonzero(arrival_camera == k) for k in range(len(number))]
    rate = np.zeros(len(at))
    for rows in arrivals_of:
        rate[rows] = _local_rate(at[rows], at[0], at[-1])
    expected = Counter[str]()
    for (_, target), times in lags.items():
        expected[target] += len(times)
    outside = np.array(
        [max(0.02, 1.0 - expected[name] / max(1, passages[k])) for name, k in number.items()]
    )
    background = outside[arrival_camera] * np.maximum(rate, 1e-6)

    # Candidates of every pair of cameras, and their hazards.
    all_lags = np.concatenate([np.array(times) for times in lags.values()] or [np.zeros(1)])
    low, high = min(low, all_lags.min() - 2), min(high, all_lags.max() + 5)
    grid = np.arange(low - 10, high + 10, GRID_SECONDS)
    pairs, columns, appears = [], [], np.zeros(len(number))
    for (source, target), times in lags.items():
        if source not in number or target not in number:
            continue
        share = len(times) / passages[number[source]]
        appears[number[source]] += share
        exits, entries = np.flatnonzero(camera == number[source]), arrivals_of[number[target]]
        density = share * _kernel(np.array(times), grid)
        i, j, value = _candidates(density, grid, begin[exits], end[exits], at[entries])
        columns.append((exits[i], entries[j], value))
        pairs.append((source, target))
    if not columns:
        return {}
    first = np.cumsum([0, *(len(column[0]) for column in columns)])
    departure, arrival, hazard = (np.concatenate(parts) for parts in zip(*columns, strict=True))
    leave = np.maximum(1.0 - appears, 0.02)[camera]

    # One-to-one: each departure goes to one arrival or leaves, each arrival comes from one
    # departure or from outside.
    message, share_of = np.ones(len(hazard)), np.zeros(len(hazard))
    for _ in range(SWEEPS):
        claims = np.bincount(departure, hazard * message, minlength=len(history))
        offer = hazard / np.maximum(leave[departure] + claims[departure] - hazard * message, 1e-9)
        demand = background[arrival] + np.bincount(arrival, offer, minlength=len(history))[arrival]
        message, share_of = 1.0 / np.maximum(demand - offer, 1e-12), offer / demand

    # Evidence of each link.
    nats = {}
    for k, pair in enumerate(pairs):
        if pair in true:
            part = share_of[first[k] : first[k + 1]]
            nats[pair] = float(-np.log1p(-np.minimum(part, 1 - 1e-6)).sum() - len(lags[pair]))
    return nats


GRID_SECONDS = 0.25
"""Step of the grid of lags, seconds."""
SWEEPS = 4
"""Sweeps of the assignment."""
HAZARD_MIN = 1e-7
"""Least hazard of a candidate, per second."""


def _kernel(lags: Floats, grid: Floats) -> Floats:
    """Return a density over the grid: Gaussian around each lag."""
    quartiles = np.subtract(*np.percentile(lags, [75, 25])) / 1.34
    width = max(0.75, 0.9 * min(np.std(lags), quartiles or 1.0) * len(lags) ** -0.2)
    counts = np.histogram(lags, bins=np.append(grid, grid[-1] + GRID_SECONDS) - GRID_SECONDS / 2)[0]
    bump = np.arange(-4 * width, 4 * width + GRID_SECONDS, GRID_SECONDS)
    return _spread(counts, np.exp(-0.5 * (bump / width) ** 2) / (width * np.sqrt(2 * np.pi))) / len(
        lags
    )


def _candidates(
    density: Floats, grid: Floats, begin: Floats, end: Floats, arrivals: Floats
) -> tuple[NDArray[np.intp], NDArray[np.intp], Floats]:
    """Return departures and arrivals with a possible lag, and the density at each lag.

    No arrival precedes the beginning of the departure's passage.
    """
    live = np.flatnonzero(density > HAZARD_MIN)
    shortest, longest = (grid[live[0]], grid[live[-1]]) if len(live) else (grid[0], grid[0])
    low = np.searchsorted(arrivals, np.maximum(end + shortest, begin))
    n = np.maximum(np.searchsorted(arrivals, end + longest, side="right") - low, 0)
    departure = np.repeat(np.arange(len(end)), n)
    arrival = np.arange(n.sum()) - np.repeat(np.cumsum(n) - n, n) + np.repeat(low, n)
    value = np.interp(arrivals[arrival] - end[departure], grid, density)
    is_likely = value > HAZARD_MIN
    return departure[is_likely], arrival[is_likely], value[is_likely]


def _local_rate(t: Floats, first: float, last: float) -> Floats:
    """Return the events a second around each of the times (n,), within about two minutes."""
    edges = np.arange(first, last + 60.0, 30.0)
    bump = np.exp(-0.5 * (np.arange(-16, 17) / 4) ** 2) / (4 * np.sqrt(2 * np.pi))
    rate: Floats = np.interp(t, edges[:-1] + 15.0, _spread(np.histogram(t, edges)[0], bump) / 30.0)
    return rate


def _spread(counts: NDArray[np.int64], bump: Floats) -> Floats:
    """Convolve counts with a symmetric bump and keep their length."""
    half = len(bump) // 2
    spread: Floats = np.convolve(counts, bump)[half : half + len(counts)]
    return spread


def pairs_of(links: Sequence[CameraPair]) -> set[frozenset[str]]:
    """Return the unordered camera pairs of links."""
    return {frozenset(pair) for pair in links}
