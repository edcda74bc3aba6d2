"""Measure how soon the learner detects that paths change, and how often it is wrong.

    python -m bench change [--seeds N] [--first-seed S] [--hours H] [--doors D]
                           [--jobs close,open,steady,score] [--objects RATE] [--rhythm SHARE]

Half-way through a simulated recording some doors (paths, in both directions) close (`close`) or
open (`open`). A link is right from the first version after which it stays unpublished, or stays
published; the delay of a link that is never right is infinite. Delays are in passages. For an
opened door these are the recorded passages through it, for a closed one those that would have
taken it: departures at its zone times its share before. Versions are made when they fall due, so
the wait for the next version is part of the delay.

`steady` counts the versions with an alarm where nothing changes. `score` compares the learner's
scores of its own predictions with scores by the ground truth of the same exits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from bench.support.parts import part_parser
from bench.support.prediction_scores import next_entries
from camtopod.learn.learner import Learner
from camtopod.learn.outcomes import ScoredPrediction
from camtopod.learn.self_score import Scorer, Scores, marks
from camtopod.records import Event, Topology
from camtopod.sim.scoring import match_zones
from camtopod.sim.settings import SimSettings
from camtopod.sim.simulation import simulate
from camtopod.sim.truth import TrueLink, Truth

JOBS = ("close", "open", "steady", "score")
"""Names of the measurements."""
SOON_PASSAGES = (20, 40, 80)
"""Numbers of passages after which the share of right links is reported."""


class Outcome(NamedTuple):
    """Outcome of one link: passages before the change, after it, and until it was right (nan:
    never).

    ``known``: whether a link that closed had been published at all; ``alarmed``: whether it was
    reported.
    """

    known: bool

    before: float
    after: float
    needed: float
    alarmed: bool


def main(argv: list[str]) -> int:
    """Run the jobs and return the exit status."""
    parser = part_parser(__name__, __doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--hours", type=float, default=1.5)
    parser.add_argument("--doors", type=int, default=2)
    parser.add_argument("--objects", type=float, help="objects that enter the network, per second")
    parser.add_argument("--rhythm", type=float, default=0.0)
    parser.add_argument("--jobs", default=",".join(JOBS))
    arguments = parser.parse_args(argv)
    for job in arguments.jobs.split(","):
        base = SimSettings(
            hours=arguments.hours,
            objects_per_second=arguments.objects,
            rhythm=arguments.rhythm,
            rhythm_hours=arguments.hours / 2,
        )
        seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
        {"close": _doors, "open": _doors, "steady": _steady, "score": _score}[job](
            job, base, seeds, arguments.doors
        )
    return 0


def versions(events: Sequence[Event]) -> Iterator[Topology]:
    """Yield every version; events are fed as `camtopod learn` feeds them."""
    learner = Learner()
    for event in events:
        learner.receive(event)
        yield from learner.updates()
    learner.flush()
    yield from learner.updates()


def _doors(job: str, base: SimSettings, seeds: range, doors: int) -> None:
    """Measure and print the changed links of all seeds."""
    rows: list[Outcome] = []
    false = 0
    for seed in seeds:
        outcomes, wrong = _measure(job, base, seed, doors)
        rows += outcomes
        false += wrong
        for row in outcomes:
            print(
                f"{job} seed {seed}: "
                + " ".join(f"{name} {value:g}" for name, value in row._asdict().items()),
                flush=True,
            )
    print(*summary(job, rows), sep="\n")
    print(f"{job}: {false} alarms about opening or closing for other links")


def summary(job: str, rows: Sequence[Outcome]) -> list[str]:
    """Return how soon links were right, and the shares that were so within some passages.

    The shares are of links with at least as many passages since the change.
    """
    lines = []
    for least in (0, *SOON_PASSAGES):
        outcomes = [row for row in rows if row.known and row.after >= least]
        if not outcomes:
            continue
        passages = np.array([np.inf if np.isnan(row.needed) else row.needed for row in outcomes])
        low, middle, high = np.quantile(passages, (0.25, 0.5, 0.75), method="higher")
        line = f"{job}, {len(outcomes)} links of {least} passages or more since: "
        line += f"{int(np.isfinite(passages).sum())} found, "
        line += f"after a median of {middle:.0f} passages "
        line += f"(quartiles {low:.0f} to {high:.0f})"
        if least:
            line += f", within {least}: {np.mean(passages <= least):.2f}"
        lines.append(f"{line}; {sum(row.alarmed for row in outcomes)} alarms")
    return lines


def _measure(job: str, base: SimSettings, seed: int, doors: int) -> tuple[list[Outcome], int]:
    """Return the changed links of one network and the number of false alarms."""
    doors_closed, doors_opened = (doors, 0) if job == "close" else (0, doors)
    settings = replace(base, seed=seed, doors_closed=doors_closed, doors_opened=doors_opened)
    events, truth = simulate(settings)
    history = list(versions(events))
    changed_links = {
        (link.from_, link.to): link for link in truth.links if link.closed_at or link.opened_at
    }

    # Learned zone of each true one, in the newest version that has it.
    ids: dict[str, str] = {}
    for version in reversed(history):
        ids = match_zones(version.zones, truth.zones) | ids
    outcomes = [
        _outcome(job, link, ids, events, truth, history, base.start + base.hours * 1800)
        for link in changed_links.values()
    ]

    # Alarms about other links are false.
    names = {f"{ids.get(link.from_)}->{ids.get(link.to)}" for link in changed_links.values()}
    kinds = ("link_opened", "link_closed")
    wrong = [a for a in history[-1].alarms or [] if a.kind in kinds and a.subject not in names]
    for alarm in wrong:
        print(
            f"{job} seed {seed}: other alarm {alarm.kind} {alarm.subject} {alarm.detail} "
            f"in version {alarm.version}"
        )
    return outcomes, len(wrong)


def _outcome(
    job: str,
    link: TrueLink,
    ids: dict[str, str],
    events: Sequence[Event],
    truth: Truth,
    history: list[Topology],
    moment: float,
) -> Outcome:
    """Return the outcome of one changed link."""
    # Passages, departures at the zone, and when the link became right.
    transitions = np.array(_walked(link, events, truth))
    source = [zone.id for zone in truth.zones].index(link.from_)
    left = np.array(
        [e.t for e, z in zip(events, truth.zone, strict=True) if e.kind == "exit" and z == source]
    )
    key = ids.get(link.from_), ids.get(link.to)
    right = np.nan
    for version in history:
        if version.as_of <= moment:
            continue
        is_published = any((x.from_, x.to) == key for x in version.links)
        if is_published != (job == "open"):
            right = np.nan
        elif np.isnan(right):
            right = version.as_of

    # Passages before, after, and until then.
    before, after = float(np.sum(transitions < moment)), float(np.sum(transitions >= moment))
    if job == "close":
        rate = before / max(int(np.sum(left < moment)), 1)
        after = float(rate * np.sum(left >= moment))
        passages = (
            rate * float(np.sum((left >= moment) & (left <= right))) if right == right else np.nan
        )
    else:
        passages = (
            float(np.sum((transitions >= moment) & (transitions <= right)))
            if right == right
            else np.nan
        )

    # Alarm, and whether it was published before.
    kind = f"link_{'closed' if job == 'close' else 'opened'}"
    alarmed = any(
        (a.kind, a.subject) == (kind, f"{key[0]}->{key[1]}") for a in history[-1].alarms or []
    )
    last = [version for version in history if version.as_of <= moment][-1]
    is_known = job == "open" or any((x.from_, x.to) == key for x in last.links)
    return Outcome(is_known, round(before, 1), round(after, 1), round(float(passages), 1), alarmed)


def _walked(link: TrueLink, events: Sequence[Event], truth: Truth) -> list[float]:
    """Return the times of departure of the link's transitions with both ends recorded."""
    zones = [zone.id for zone in truth.zones]
    return [
        events[k].t
        for k, entry in enumerate(next_entries(events, truth))
        if entry >= 0
        and zones[truth.zone[k]] == link.from_
        and zones[truth.zone[entry]] == link.to
        and truth.passage[entry] == truth.passage[k] + 1
    ]


def _steady(job: str, base: SimSettings, seeds: range, doors: int) -> None:
    """Print the share of versions with an alarm where nothing changes."""
    total = wrong = 0
    for seed in seeds:
        events, _ = simulate(replace(base, seed=seed))
        history = list(versions(events))
        alarms = history[-1].alarms or []
        total += len(history)
        wrong += len({alarm.version for alarm in alarms})
        for alarm in alarms:
            print(
                f"steady seed {seed}: {alarm.kind} {alarm.subject} {alarm.detail} "
                f"in version {alarm.version}",
                flush=True,
            )
    print(f"steady: {wrong} of {total} versions with an alarm")


class _OracleScorer(Scorer):
    """A scorer that also scores by the ground truth."""

    def __init__(self, learner: Learner, events: Sequence[Event], truth: Truth) -> None:
        super().__init__(learner.state.scorer, None)
        self.pairs: list[tuple[Scores, Scores]] = []
        self._exits_at = {
            (round(e.t, 6), e.camera): k for k, e in enumerate(events) if e.kind == "exit"
        }
        self._next = [
            None if entry < 0 else events[entry].camera for entry in next_entries(events, truth)
        ]

    def note(self, guess: ScoredPrediction, outcome: dict[str, float]) -> None:
        super().note(guess, outcome)
        camera = self._next[self._exits_at[round(guess.t, 6), guess.camera]]
        self.pairs.append((marks(guess, outcome), marks(guess, {camera: 1.0} if camera else {})))


def _score(job: str, base: SimSettings, seeds: range, doors: int) -> None:
    """Print the learner's scores of itself beside those by the ground truth."""
    names = ("log loss", "top-1", "top-3", "baseline log loss", "baseline top-1")
    rows = []
    for seed in seeds:
        events, truth = simulate(replace(base, seed=seed))
        learner = Learner()
        scorer = learner._scorer = _OracleScorer(learner, events, truth)
        for event in events:
            learner.receive(event)
        learner.flush()
        rows.append([_figures([pair[k] for pair in scorer.pairs]) for k in (0, 1)])
        for title, row in zip(("self", "true"), rows[-1], strict=True):
            figures = ", ".join(
                f"{name} {value:.3f}" for name, value in zip(names, row, strict=True)
            )
            print(f"score seed {seed}, {len(scorer.pairs)} exits, {title}: {figures}", flush=True)
    table = np.array(rows)
    for title, row in (
        ("self", table[:, 0].mean(axis=0)),
        ("true", table[:, 1].mean(axis=0)),
        ("apart", np.abs(table[:, 0] - table[:, 1]).mean(axis=0)),
    ):
        print(
            f"score, mean {title}: "
            + ", ".join(f"{name} {v:.3f}" for name, v in zip(names, row, strict=True))
        )


def _figures(scores: list[Scores]) -> list[float]:
    """Return the means of the scores, in the order of the table."""
    m = {name: sum(getattr(mark, name) for mark in scores) for name in Scores._fields}
    weight = max(m["return_probability"], 1e-9)
    return [
        m["loss"] / len(scores),
        m["top1"] / weight,
        m["top3"] / weight,
        m["baseline_loss"] / len(scores),
        m["baseline_top1"] / weight,
    ]
