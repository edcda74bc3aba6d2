"""`camtopod score`: how links, predictions and matches fare against known identities.

The rules are those of `bench real`. The oracle is a Markov chain that is told the identities: the
next cameras of all other exits at the same zone, backed off to those at its camera, and anywhere.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, TypeVar

from msgspec import Struct

from camtopod.cli import exits
from camtopod.cli.commands.predict import by_moment, matching, predicting
from camtopod.cli.common import topology_of
from camtopod.cli.events.event_lines import LineReader, table_rows_of
from camtopod.cli.events.recording import Times, fault_of, once_by_number, recorded
from camtopod.cli.exits import InputError
from camtopod.cli.terminal import Progress
from camtopod.records import Event, Match, Prediction, Topology
from camtopod.topology import camera_of, links_between_views
from camtopod.words import sum_by_camera

LEAVES = ""
"""Outcome of an exit that nothing follows; no camera has this name."""
WINDOW_SECONDS_MAX = 180.0
"""Longest time from an exit to the entry that follows, or a tenth of the recording."""
TRANSITIONS_MIN, TRANSITIONS_SHARE_MIN = 5, 0.03
"""Least transitions of a true link, and least share of all transitions from its camera."""
SPURIOUS_TRANSITIONS_MAX = 2
"""Most transitions of a false link; one with more, which is no true link, is neither."""
BACKING_EXITS = 2.0
"""Weight of the shares that the oracle's counts are backed off to."""
LOSS_FLOOR = 1e-3
"""Added to each outcome's probability before its logarithm is taken."""

AnswerT = TypeVar("AnswerT", Prediction, Match)
Key = tuple[str, str]
"""Camera and track of a passage."""


class _Identity(Struct):
    """A row of the file of identities."""

    track: str = ""
    identity: str = ""
    camera: str | None = None


class TruePassage(Struct, eq=False):
    """A passage (times in seconds) with its identity, and what came before and after it."""

    key: Key
    identity: str
    came: float
    left: float
    outcome: str = LEAVES
    """Camera of the identity's next passage."""
    since: float = math.inf
    """Time from the end of the passage before."""


def add_parser(add: Any) -> None:
    """Add `score`."""
    parser = add(
        description="Scores a topology by the identities of a recording: links between cameras, "
        "predictions of the next camera beside an oracle that is told the identities, and matches "
        "of entries with earlier passages. Events after those that were learned count, if any.",
        epilog="example: camtopod score topology.json events.jsonl identities.csv",
    )
    parser.add_argument("topology", metavar="TOPOLOGY.json", help="as `camtopod learn` writes it")
    parser.add_argument("events", metavar="EVENTS", help="the recording; its events have tracks")
    parser.add_argument(
        "identities",
        metavar="IDENTITIES.csv",
        help="columns track, identity and, unless tracks differ between cameras, camera",
    )


def run(args: argparse.Namespace) -> int:
    """Print the scores. Raises `InputError`."""
    topology = topology_of(args.topology)
    reader = LineReader()
    times = Times()
    lines = once_by_number(reader, recorded(reader, [args.events], times))
    events = [line.event for line in lines]
    if (summary := reader.summary()) is not None:
        print(f"camtopod: {summary}", file=sys.stderr)
    passages = passages_of(events, args.identities)
    if not passages:
        raise InputError(f"no track of {args.events} has an identity in {args.identities}")

    # Score the events after the window, up to the last exit whose outcome is certain.
    window = min(WINDOW_SECONDS_MAX, (events[-1].t - events[0].t) / 10)
    begin, end = topology.as_of, events[-1].t - window
    if not any(begin < passage.left <= end for passage in passages.values()):
        print("camtopod: these events were learned: the scores are too good", file=sys.stderr)
        begin = -math.inf
    texts = link_lines(topology, passages.values())
    predictions = list(_given(by_moment(predicting(topology), events), len(events), "predicted"))
    texts += prediction_lines(predictions, passages, begin, end)
    every_match = _given(by_moment(matching(topology), events), len(events), "matched")
    matches = [match for match in every_match if match.t > begin]
    print("\n".join([*texts, *match_lines(matches, passages, window)]))
    if (fault := fault_of(times)) is not None:
        print(f"camtopod: {fault}", file=sys.stderr)
        return exits.FAILED
    return reader.status


def _given(answers: Iterator[AnswerT | None], count: int, unit: str) -> Iterator[AnswerT]:
    """Yield the answers that are one, and show progress through ``count`` events."""
    with Progress() as progress:
        for number, answer in enumerate(answers, 1):
            progress.show("%d of %d events %s", number, count, unit)
            if answer is not None:
                yield answer


def passages_of(events: Sequence[Event], path: str) -> dict[Key, TruePassage]:
    """Return the passages that have an identity in a file. Raises `InputError`."""
    identity: dict[tuple[str | None, str], str] = {}
    for _, row in table_rows_of(path, ("track", "identity"), _Identity):
        identity[row.camera, row.track] = row.identity

    # Passages, and those of each identity in order.
    passages: dict[Key, TruePassage] = {}
    of_identity: dict[str, list[TruePassage]] = defaultdict(list)
    for event in events:
        key = event.camera, str(event.track)
        person = identity.get(key) or identity.get((None, key[1]))
        if not person:
            continue
        if key not in passages:
            passages[key] = TruePassage(key, person, event.t, event.t)
            of_identity[person].append(passages[key])
        passages[key].left = event.t
    for walk in of_identity.values():
        for passage, next_passage in pairwise(
            sorted(walk, key=lambda passage: (passage.came, passage.left, passage.key))
        ):
            passage.outcome = next_passage.key[0]
            next_passage.since = next_passage.came - passage.left
    return passages


def link_lines(topology: Topology, passages: Iterable[TruePassage]) -> list[str]:
    """Return the score of the links between cameras."""
    transitions = Counter(
        (passage.key[0], passage.outcome)
        for passage in passages
        if passage.outcome not in (LEAVES, passage.key[0])
    )
    left = Counter[str]()
    for (camera, _), number in transitions.items():
        left[camera] += number
    true = {
        pair
        for pair, number in transitions.items()
        if number >= max(TRANSITIONS_MIN, TRANSITIONS_SHARE_MIN * left[pair[0]])
    }
    published_pairs = {
        (camera_of(link.from_), camera_of(link.to)) for link in links_between_views(topology)
    }
    right = published_pairs & true
    false = {pair for pair in published_pairs if transitions[pair] <= SPURIOUS_TRANSITIONS_MAX}
    lines = [
        f"links between cameras: {len(right)} of {len(true)} true ones found, {len(false)} false; "
        f"precision {_share(len(right), len(right) + len(false))}, "
        f"recall {_share(len(right), len(true))}"
    ]
    for name, pairs in (("missing", true - published_pairs), ("false", false)):
        lines += [f"  {name}: {a} -> {b}, {transitions[a, b]} times" for a, b in sorted(pairs)]
    return lines


def prediction_lines(
    predictions: Sequence[Prediction], passages: Mapping[Key, TruePassage], begin: float, end: float
) -> list[str]:
    """Return the score of the predictions of exits from ``begin`` to ``end``, and the oracle's."""
    cases = [
        (prediction, passages[key])
        for prediction in predictions
        if (key := (prediction.camera, str(prediction.track))) in passages
    ]
    outcomes = sorted({passage.key[0] for passage in passages.values()} | {LEAVES})
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    for prediction, passage in cases:
        for place in ("", prediction.camera, prediction.zone or prediction.camera):
            counts[place][passage.outcome] += prediction.t <= end

    # Score both.
    scores: dict[str, list[tuple[bool, float]]] = {"camtopod": [], "told": []}
    for prediction, passage in cases:
        if not begin < prediction.t <= end:
            continue
        baseline = dict.fromkeys(outcomes, 1.0 / len(outcomes))
        for place in ("", prediction.camera, prediction.zone or prediction.camera):
            other_counts = counts[place] - Counter([passage.outcome])
            total = other_counts.total() + BACKING_EXITS
            baseline = {
                name: (other_counts[name] + BACKING_EXITS * baseline[name]) / total
                for name in outcomes
            }
        predicted_shares = sum_by_camera(prediction.candidates)
        for name, shares in (
            ("camtopod", predicted_shares | {LEAVES: prediction.leave}),
            ("told", baseline),
        ):
            share = (shares.get(passage.outcome, 0.0) + LOSS_FLOOR) / (
                1.0 + LOSS_FLOOR * len(outcomes)
            )
            first = max(shares, key=lambda outcome: shares[outcome])
            scores[name].append((first == passage.outcome, -math.log(share)))

    means = {
        name: [sum(column) / len(column) for column in zip(*rows, strict=True)]
        for name, rows in scores.items()
        if rows
    }
    return [f"next camera of {len(scores['told'])} exits:"] + [
        f"  {name}: top-1 {top1:.2f}, log loss {loss:.2f} nats"
        for name, (top1, loss) in means.items()
    ]


def match_lines(
    matches: Sequence[Match], passages: Mapping[Key, TruePassage], window: float
) -> list[str]:
    """Return the score of the matches with a passage that has more than one half."""
    cases = [
        (match, passages[key])
        for match in matches
        if (key := (match.camera, str(match.track))) in passages
    ]
    going_on = sum(passage.since <= window for _, passage in cases)
    claim_count = right = 0
    for match, passage in cases:
        if match.from_ and match.from_[0].probability > 0.5:
            before = passages.get((match.from_[0].camera, str(match.from_[0].track)))
            claim_count += 1
            right += before is not None and before.identity == passage.identity
    return [
        f"matches: {going_on} of {len(cases)} entries go on with a walk; {claim_count} are said to "
        f"with more than one half, {right} of them rightly ({_share(right, claim_count)})"
    ]


def _share(part: int, whole: int) -> str:
    return f"{part / whole:.2f}" if whole else "-"
