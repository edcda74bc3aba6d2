"""Score the links, predictions and matches of a topology by known identities.

The rules are those of `bench real`. The oracle is a Markov chain that is given the identities: the
next cameras of all other exits at the same zone, backed off to those at its camera, and anywhere.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, TypeVar

from msgspec import Struct

from camtopod.codec import require_topology, time_of
from camtopod.predict import by_moment, matching, predicting
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
Pairs = dict[tuple[str, str], int]
"""Pairs of cameras (from, to), and the number of true transitions between them."""
Identities = Mapping[Any, object]
"""Identity of the object of each (camera, track)."""
OnEvent = Callable[[int, str], object]
"""Called after each event with its number and the step, ``predicted`` or ``matched``."""


class TruePassage(Struct, eq=False):
    """A passage (times in seconds) with its identity, and what came before and after it."""

    key: Key
    identity: object
    came: float
    left: float
    outcome: str = LEAVES
    """Camera of the identity's next passage."""
    since: float = math.inf
    """Time from the end of the passage before."""


class RecordingScore(Struct, frozen=True):
    """Scores of a topology by the identities of a recording; `str` is the report.

    links: the true links that the topology has. missing: those that it has not. false: its links
        that are none; one with more than `SPURIOUS_TRANSITIONS_MAX` transitions is neither.
    exits: number of predictions that are scored.
    predictions: for ``camtopod`` and the ``oracle``, the share of these whose likeliest next camera
        is right, and the log loss, nats; empty if there are none.
    entries: number of matches. going_on: of these, the entries that go on with a walk.
    claims: matches with a passage of more than one half. right: those of the same identity.
    learned: True if the topology was learned from these events, so that the scores are too good.
    """

    links: Pairs
    missing: Pairs
    false: Pairs
    exits: int
    predictions: dict[str, tuple[float, float]]
    entries: int
    going_on: int
    claims: int
    right: int
    learned: bool

    @property
    def precision(self) -> float:
        """Share of the links that are true; nan if there are none."""
        return _ratio(len(self.links), len(self.links) + len(self.false))

    @property
    def recall(self) -> float:
        """Share of the true links that the topology has; nan if there are none."""
        return _ratio(len(self.links), len(self.links) + len(self.missing))

    def __str__(self) -> str:
        lines = [
            f"links between cameras: {len(self.links)} of {len(self.links) + len(self.missing)} "
            f"true ones found, {len(self.false)} false; precision {_text(self.precision)}, "
            f"recall {_text(self.recall)}"
        ]
        for name, pairs in (("missing", self.missing), ("false", self.false)):
            lines += [f"  {name}: {a} -> {b}, {n} times" for (a, b), n in sorted(pairs.items())]
        exits = f"next camera of {self.exits} exits:"
        lines.append(exits if self.exits else "next camera: no exits with an identity to score")
        lines += [
            f"  {name}: top-1 {top1:.2f}, log loss {loss:.2f} nats"
            for name, (top1, loss) in self.predictions.items()
        ]
        share = _text(_ratio(self.right, self.claims))
        if not self.entries:
            return "\n".join([*lines, "matches: no entries with an identity to score"])
        lines.append(
            f"matches: {self.going_on} of {self.entries} entries go on with a walk; {self.claims} "
            f"are said to with more than one half, {self.right} of them rightly ({share})"
        )
        return "\n".join(lines)


def score(
    topology: Topology,
    events: Iterable[Event],
    identities: Identities,
    on_event: OnEvent | None = None,
) -> RecordingScore:
    """Score a topology by the identities of a recording, as `camtopod score` does.

        >>> from camtopod import load_events, load_topology, score
        >>> events = load_events("events.jsonl")
        >>> walkers = {(event.camera, event.track): event.track for event in events}
        >>> result = score(load_topology("topology.json"), events, walkers)
        >>> result.precision, result.recall, result.learned
        (1.0, 1.0, True)

    events: the recording, in any order; those after the learned ones are scored, or all if there
        are none.
    identities: identity of the object of each (camera, track); None in place of the camera if
        tracks differ between cameras. Clutter has no identity.
    on_event: called after each event, for a display of progress.

    Links, the next camera of each exit, and the earlier passage of each entry are scored. Raises
    ValueError if there are no events, if no track has an identity, if the topology is of other
    cameras, or for another key of ``identities``.
    """
    require_topology(topology)
    for key in identities:
        if not (isinstance(key, tuple) and len(key) == 2):
            raise ValueError(
                f"{key!r} is no key of identities: give (camera, track), or (None, track) if tracks"
                " differ between cameras"
            )
    recording = sorted(events, key=time_of)
    if not recording:
        raise ValueError("there are no events")
    passages = passages_of(recording, identities)
    if not passages:
        raise ValueError("no track of the events has an identity")
    if not {camera.id for camera in topology.cameras} & {event.camera for event in recording}:
        raise ValueError("the topology has no camera of the events: it is of another site")

    # Score the events after the window, up to the last exit whose outcome is certain.
    window = min(WINDOW_SECONDS_MAX, (recording[-1].t - recording[0].t) / 10)
    begin, end = topology.as_of, recording[-1].t - window
    is_learned = not any(begin < passage.left <= end for passage in passages.values())
    if is_learned:
        begin = -math.inf
    by_exit = _answers(by_moment(predicting(topology), recording), "predicted", on_event)
    by_entry = _answers(by_moment(matching(topology), recording), "matched", on_event)
    matches = [match for match in by_entry if match.t > begin]
    links, missing, false = _link_score(topology, passages.values())
    exits, predictions = _prediction_score(list(by_exit), passages, begin, end)
    counts = _match_score(matches, passages, window)
    return RecordingScore(links, missing, false, exits, predictions, *counts, is_learned)


def _answers(
    answers: Iterator[AnswerT | None], unit: str, on_event: OnEvent | None
) -> Iterator[AnswerT]:
    """Yield the predictions, or the matches, without the events that have none."""
    for number, answer in enumerate(answers, 1):
        if on_event is not None:
            on_event(number, unit)
        if answer is not None:
            yield answer


def passages_of(events: Iterable[Event], identities: Identities) -> dict[Key, TruePassage]:
    """Return the passages of events, in order of time, that have an identity."""
    identity = {(camera, str(track)): person for (camera, track), person in identities.items()}
    passages: dict[Key, TruePassage] = {}
    of_identity: dict[object, list[TruePassage]] = defaultdict(list)
    for event in events:
        key = event.camera, str(event.track)
        person = identity.get(key, identity.get((None, key[1])))
        if person is None or event.track is None:
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


def _link_score(topology: Topology, passages: Iterable[TruePassage]) -> list[Pairs]:
    """Return the true links that the topology has, those that it has not, and its false ones."""
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
    false = {pair for pair in published_pairs if transitions[pair] <= SPURIOUS_TRANSITIONS_MAX}
    groups = (published_pairs & true, true - published_pairs, false)
    return [{pair: transitions[pair] for pair in group} for group in groups]


def _prediction_score(
    predictions: Sequence[Prediction], passages: Mapping[Key, TruePassage], begin: float, end: float
) -> tuple[int, dict[str, tuple[float, float]]]:
    """Return the number of exits from ``begin`` to ``end`` with a prediction, and the scores."""
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
    scores: dict[str, list[tuple[bool, float]]] = {"camtopod": [], "oracle": []}
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
        predicted_shares = sum_by_camera(prediction.next)
        for name, shares in (
            ("camtopod", predicted_shares | {LEAVES: prediction.leave}),
            ("oracle", baseline),
        ):
            share = (shares.get(passage.outcome, 0.0) + LOSS_FLOOR) / (
                1.0 + LOSS_FLOOR * len(outcomes)
            )
            first = max(shares, key=lambda outcome: shares[outcome])
            scores[name].append((first == passage.outcome, -math.log(share)))

    return len(scores["oracle"]), {
        name: (
            sum(is_right for is_right, _ in rows) / len(rows),
            sum(loss for _, loss in rows) / len(rows),
        )
        for name, rows in scores.items()
        if rows
    }


def _match_score(
    matches: Sequence[Match], passages: Mapping[Key, TruePassage], window: float
) -> tuple[int, int, int, int]:
    """Return the numbers of matches, of entries that go on, of claims, and of right ones."""
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
    return len(cases), going_on, claim_count, right


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else math.nan


def _text(share: float) -> str:
    return "-" if math.isnan(share) else f"{share:.2f}"
