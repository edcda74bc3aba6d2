"""Measure end to end what is learned from the grabber's events, beside what true events teach.

    python -m bench views [FOLDER] [--runs 4] [--model FILE] [--films FOLDER]

FOLDER holds synchronised clips with a truth.json (bench/support/truth_clips.py) whose events have a
``person``, or SceneScape's recording of two cameras (bench/support/scenescape.py). Without it the
demo's site is rendered (about two minutes a run; ``--films`` keeps the films), with people who stop
and walk in company.

Clips are too short to learn from, so each person in them stands for many visitors. A visitor comes
at a random time, 45 s after the last one on average, and has all events of one person: the true
ones, or those of the grabber in one of its four phases (`bench.grab_truth`). Times within a visit
are stretched by a smooth random factor, the same for both; positions are blurred. Events of the
grabber that belong to nobody are added to one visitor in five. Events that come later than the
daemon waits for are not learned.

The same learner learns the true events and those of the grabber. A person walks a link from an exit
to the entry of a passage that was under way at the exit, or to the next entry, unless every view
that still saw the person at the exit is left before it. A link between the learned zones next to
both events is true if it is walked often enough (as in `bench real`), and false if hardly anybody
walks it. Where views overlap, more links are true than are needed, so the column of the
true events shows what can be expected. All clocks are right.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path
from statistics import median

import msgspec
import numpy as np
from msgspec import Struct

from bench.demo import START, recorded
from bench.grab_truth import PHASES, detector_of, grabbed
from bench.scenes.recording import PAIR_WALKS_MIN
from bench.scenes.stops import with_stops
from bench.support.measure import CLOCK_SECONDS_MAX
from bench.support.parts import part_parser
from bench.support.recordings import (
    SPURIOUS_TRANSITIONS_MAX,
    TRANSITIONS_MIN,
    TRANSITIONS_SHARE_MIN,
)
from bench.support.scenescape import scenescape_clips
from bench.support.truth_clips import TRUTH, Clip, TruthError, clips_in, place_of
from bench.support.watched_clips import match
from camtopod.cli.commands.demo import MINUTES, WALKERS_PER_SECOND
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.records import Event, Topology
from camtopod.sim.floor import HEIGHT, WIDTH, demo_plan, passages, simulate_walks
from camtopod.sim.scoring import ZONE_TOLERANCE

RUNS = 4
VISITORS, BETWEEN_SECONDS = 400, 45.0
"""Visitors of a run, and the mean time from one to the next, seconds."""
STRETCH_SD, STRETCH_SECONDS = 0.7, 10.0
"""Spread of the factor on times (log scale), and the time in which it changes, seconds."""
BLUR = 0.012
"""Spread of places, fraction of the image."""
ALONG_SHARE = 0.2
"""Share of the visitors with whom goes what is not true."""
TRANSIT_SECONDS, TRANSIT_SHARE = 1.0, 0.2
"""A transit time is right within this, or within this share of the true median."""


class Passage(Struct):
    """A person's true passage through a view; one in view at the beginning has no entry."""

    person: str
    camera: str
    entry: Event | None
    exit: Event | None

    @property
    def begin(self) -> float:
        """Time of the entry, seconds."""
        return -np.inf if self.entry is None else self.entry.t

    @property
    def end(self) -> float:
        """Time of the exit, seconds."""
        return np.inf if self.exit is None else self.exit.t


class Network(Struct):
    """Counts of a learned topology, beside the truth."""

    pairs: float
    """True pairs of cameras: people are in both views at once, or go from one to the other."""
    pairs_found: float
    pairs_related: float
    """Found ones with the true relation: overlapped, or an unseen path."""
    pairs_false: float
    overlaps: float
    """Pairs that are called overlapped."""
    links_learned: float
    links_true: float
    """True ones."""
    links_timed: float
    """Those of them with the right transit time."""
    links_false: float
    transit_error: float
    """Median error of the median transit time, seconds."""
    clocks: float
    """Right clocks that are called wrong."""
    clock_error: float
    """Largest clock offset that is claimed, seconds."""


_ROWS = (
    "pairs of cameras, true",
    "    found",
    "    of them with the right relation",
    "    false",
    "    called overlapped",
    "links learned",
    "    true",
    "    of them with the right transit time",
    "    false",
    "    median error of the transit time, s",
    "clocks, all right: called wrong",
    "    largest offset claimed, s",
)
"""Titles of `Network`'s fields, in order."""


class Recording(Struct):
    """What is learned in one run: true passages, and events by time."""

    passages: list[Passage]
    true: list[Event]
    seen: list[Event]


def main(argv: list[str]) -> int:
    """Print the table and return the exit status."""
    parser = part_parser(__name__, __doc__)
    add = parser.add_argument
    add("folder", nargs="?", type=Path, metavar="FOLDER", help="synchronised clips with truth")
    add("--runs", type=int, default=RUNS, help="times that all is learned (default: %(default)s)")
    add("--model", metavar="FILE", help="with this detector, an ONNX file")
    add("--films", type=Path, metavar="FOLDER", help="folder to keep the rendered films in")
    arguments = parser.parse_args(argv)

    # Record and learn.
    try:
        if arguments.folder is None:
            recordings = rendered(arguments.runs, arguments.films)
        else:
            recordings = revisited(
                clips_of(arguments.folder, arguments.model), arguments.runs, arguments.model
            )
        networks = [
            (
                judged(learned(recording.true), recording.passages),
                judged(learned(recording.seen), recording.passages),
            )
            for recording in recordings
        ]
    except TruthError as error:
        print(f"views: {error}", file=sys.stderr)
        return 1

    # Means over the runs.
    print(f"{'mean of ' + str(len(networks)) + ' runs':40}{'as true':>10}{'as grabbed':>12}")
    columns = [
        np.mean([msgspec.structs.astuple(network) for network in side], axis=0)
        for side in zip(*networks, strict=True)
    ]
    for title, true, seen in zip(_ROWS, *columns, strict=True):
        print(f"{title:40}{true:>10.1f}{seen:>12.1f}")
    return 0


def learned(events: Sequence[Event]) -> Topology:
    """Return what the learner learns from events by time."""
    learner = Learner(only_last=True)
    for event in events:
        learner.receive(event)
    learner.flush()
    assert learner.topology is not None, "no events"
    return learner.topology


# -- recordings ------------------------------


def clips_of(folder: Path, model: str | None) -> list[Clip]:
    """Return clips of which each true event has a person; raises `TruthError`."""
    if (folder / "gtLoc.json.gz").exists():
        return scenescape_clips(folder, colour=bool(model))
    clips = clips_in(folder, colour=bool(model))
    clips = [clip for clip in clips if all(event.track is not None for event in clip.truth)]
    if not any(clip.truth for clip in clips):
        raise TruthError(f"{folder}: no clip whose events have a person in {TRUTH}")
    return clips


def revisited(clips: Sequence[Clip], runs: int, model: str | None) -> list[Recording]:
    """Return recordings of many visitors, made of the people in short clips."""
    true: dict[str, list[Event]] = defaultdict(list)
    for clip in clips:
        for event in clip.truth:
            true[str(event.track)].append(event)

    # What the grabber tells, by phase and by whose events they are; "" for nobody's.
    detector, lateness = detector_of(model), Settings().lateness_seconds
    grabs: list[dict[str, list[Event]]] = []
    counts = []
    for phase in range(PHASES):
        grabs.append(defaultdict(list))
        for clip in clips:
            events, delays, _ = grabbed(clip, phase, PHASES, detector())
            in_time = [
                msgspec.structs.replace(event, camera=clip.name)
                for event, delay in zip(events, delays, strict=True)
                if delay <= lateness
            ]
            result = clip.judged(in_time)
            counts.append((len(result.pairs), len(result.misses), len(result.spurious)))
            for true_event, seen in result.pairs:
                grabs[-1][str(true_event.track)].append(seen)
            grabs[-1][""] += result.extras
    hits, misses, spurious = np.sum(counts, axis=0) / PHASES
    print(
        f"{len(clips)} views, {hits + misses:.0f} true events of {len(true)} people; mean of "
        f"{PHASES} phases: {hits:.2f} found, {misses:.2f} missed, {spurious:.2f} false"
    )
    return [visits(true, grabs, np.random.default_rng(run)) for run in range(runs)]


def visits(
    true: dict[str, list[Event]], grabs: list[dict[str, list[Event]]], rng: np.random.Generator
) -> Recording:
    """Return visitors at random times, each as one of the people.

    true, grabs: events by person, the latter of each phase.
    """
    recording, begin = Recording([], [], []), START
    last = max(event.t for events in true.values() for event in events)
    for visitor in range(VISITORS):
        begin += rng.exponential(BETWEEN_SECONDS)
        person = str(rng.choice(sorted(true)))
        seen = grabs[int(rng.integers(len(grabs)))]
        along = seen[""] if rng.random() < ALONG_SHARE else []

        # Time within the visit, from that of the clips.
        knots = np.arange(-STRETCH_SECONDS, last + 3 * STRETCH_SECONDS, STRETCH_SECONDS)
        factors = np.exp(STRETCH_SD * rng.standard_normal(len(knots)))
        steps = STRETCH_SECONDS * (factors[1:] + factors[:-1]) / 2
        stretched = np.concatenate([[0.0], np.cumsum(steps)])

        def moved(events: Iterable[Event]) -> list[Event]:
            return [
                msgspec.structs.replace(
                    event,
                    t=begin + float(np.interp(event.t, knots, stretched)),  # noqa: B023
                    x=float(np.clip(place_of(event)[0] + BLUR * rng.standard_normal(), 0, 1)),
                    y=float(np.clip(place_of(event)[1] + BLUR * rng.standard_normal(), 0, 1)),
                    track=f"{visitor}-{event.track}",  # noqa: B023
                )
                for event in events
            ]

        visit = moved(true[person])
        recording.true += visit
        recording.seen += moved([*seen[person], *along])
        recording.passages += passages_of(visit)
    recording.true.sort(key=lambda event: event.t)
    recording.seen.sort(key=lambda event: event.t)
    return recording


def passages_of(events: Iterable[Event]) -> list[Passage]:
    """Return one person's passages, by time of entry."""
    result = []
    by_camera = sorted(events, key=lambda event: (event.camera, event.t))
    for camera, camera_events in groupby(by_camera, key=lambda event: event.camera):
        entry = None
        for event in camera_events:
            if event.kind == "exit":
                result.append(Passage(str(event.track), camera, entry, event))
            entry = event if event.kind == "entry" else None
        if entry is not None:
            result.append(Passage(str(entry.track), camera, entry, None))
    return sorted(result, key=lambda passage: passage.begin)


def rendered(runs: int, films: Path | None) -> list[Recording]:
    """Return recordings of the demo's site with people who stop and go in company."""
    plan, seconds, result = demo_plan(), 60.0 * MINUTES, []
    for seed in range(1, runs + 1):
        rng = np.random.default_rng(seed)
        walks = with_stops(simulate_walks(plan, seconds, WALKERS_PER_SECOND, rng), rng)
        with tempfile.TemporaryDirectory() as temporary:
            folder = (films or Path(temporary)) / f"stops-{seed}"
            seen = recorded(plan, walks, seconds, seed, folder)
        walk: list[Passage] = []
        true: list[Event] = []
        for number, passage in enumerate(passages(plan, walks)):
            entry = Event(passage.camera, "entry", START + passage.t_in, *passage.at_in, number)
            exit_event = Event(
                passage.camera, "exit", START + passage.t_out, *passage.at_out, number
            )
            if passage.t_out < seconds:
                walk.append(Passage(str(passage.walker), passage.camera, entry, exit_event))
                true += [entry, exit_event]
        true.sort(key=lambda event: event.t)
        hits = 0
        for camera in {event.camera for event in true}:
            true_events, grabs = (
                [event for event in side if event.camera == camera] for side in (true, seen)
            )
            hits += len(match(true_events, grabs, WIDTH / HEIGHT).pairs)
        print(
            f"seed {seed}: {len(plan.views)} views, {len(true)} true events; {hits} found, "
            f"{len(true) - hits} missed, {len(seen) - hits} false",
            flush=True,
        )
        result.append(Recording(walk, true, seen))
    return result


# -- comparison ------------------------------


def judged(topology: Topology, walk: Sequence[Passage]) -> Network:
    """Compare a topology with the true passages, which are sorted by person, then by entry."""
    # True links between the learned zones, and true pairs of cameras.
    lags: dict[tuple[str, str], list[float]] = defaultdict(list)
    exits, walks = Counter[str](), Counter[tuple[str, str]]()
    together, after = Counter[tuple[str, ...]](), Counter[tuple[str, ...]]()
    for _, group in groupby(walk, key=lambda passage: passage.person):
        visit = list(group)
        for passage in visit:
            elsewhere = [o for o in visit if o.camera != passage.camera]
            beside = [o for o in elsewhere if o.begin < passage.end and o.end > passage.begin]
            until = max((o.end for o in beside if o.end > passage.end), default=np.inf)
            after_exit = [o for o in visit if passage.end <= o.begin < until][:1]
            together.update(_cameras(passage, p) for p in beside)
            after.update(_cameras(passage, p) for p in after_exit)
            if passage.exit is None:
                continue
            exits[source := zone_of(topology, passage.exit)] += 1
            entries = [o.entry for o in visit if o is not passage and o.entry is not None]
            walks.update({(source, zone_of(topology, entry)) for entry in entries})
            nearest = {}
            for p in sorted((*beside, *after_exit), key=lambda o: -abs(o.begin - passage.end)):
                if p.entry is not None:
                    nearest[source, zone_of(topology, p.entry)] = p.begin - passage.end
            for ends, lag in nearest.items():
                lags[ends].append(lag)
    links = {
        ends: link_lags
        for ends, link_lags in lags.items()
        if len(link_lags) >= max(TRANSITIONS_MIN, TRANSITIONS_SHARE_MIN * exits[ends[0]])
    }
    overlaps = {pair for pair, n in together.items() if n >= 2 * PAIR_WALKS_MIN}  # from both
    pairs = overlaps | {pair for pair, n in after.items() if n >= PAIR_WALKS_MIN}
    pairs = {pair for pair in pairs if pair[0] != pair[1]}

    # What was learned.
    link_of = {(link.from_, link.to): link for link in topology.links if link.relation != "visible"}
    errors = {
        ends: abs(link.transit.q50 - median(links[ends]))
        for ends, link in link_of.items()
        if ends in links
    }
    right_times = [
        error <= max(TRANSIT_SECONDS, TRANSIT_SHARE * abs(median(links[ends])))
        for ends, error in errors.items()
    ]
    right = [pair for pair in topology.pairs if pair.cameras in pairs]
    relations = [(pair.relation == "overlapped") == (pair.cameras in overlaps) for pair in right]
    offsets = [abs(camera.clock_offset) for camera in topology.cameras]
    return Network(
        len(pairs),
        len(right),
        sum(relations),
        len(topology.pairs) - len(right),
        sum(pair.relation == "overlapped" for pair in topology.pairs),
        len(link_of),
        len(errors),
        sum(right_times),
        sum(walks[ends] <= SPURIOUS_TRANSITIONS_MAX for ends in link_of),
        median(errors.values()) if errors else 0.0,
        sum(offset > CLOCK_SECONDS_MAX for offset in offsets),
        max(offsets),
    )


def zone_of(topology: Topology, event: Event) -> str:
    """Return the learned zone that is next to a true event; the camera's name if there is none."""
    x, y = place_of(event)
    near = [
        (np.hypot(zone.x - x, zone.y - y), zone.id)
        for zone in topology.zones
        if zone.camera == event.camera and zone.x is not None and zone.y is not None
    ]
    distance, zone = min(near, default=(np.inf, ""))
    return zone if distance <= ZONE_TOLERANCE else event.camera


def _cameras(first: Passage, second: Passage) -> tuple[str, ...]:
    return tuple(sorted((first.camera, second.camera)))
