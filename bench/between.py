"""Measure how well the number of objects between cameras is known, on real networks.

    python -m bench between [--data FOLDER] [--networks a,b] [--jobs 2] [--json FILE]

Networks and cut are those of `bench real`. The first 70 % of the events are learned. The events
from an hour before the cut on are then replayed: every exit is predicted, and every entry is
matched at once and again ten seconds later, as the daemon does. From the cut on, the number of
objects between cameras is estimated every ten minutes, or at ten equal intervals in a recording
with fewer than ten such moments. The last moment is a lag window before the end.

The true number at a moment counts the identities that were seen since the replay began, are in no
view, and are seen again within an hour or before the recording ends. Two simple estimates are
compared: exits less entries since the replay began, but at least zero ("balance"), and zero. The
figures are the mean absolute error, and the coverage: the share of moments at which the 80 %
interval holds the true number, and at which a simple estimate equals it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from msgspec import Struct

from bench.support.figures import line_of
from bench.support.parts import networks_parser, results_of
from bench.support.recordings import Recording, load
from camtopod.arrays import Floats
from camtopod.learn.recording import learn_topology
from camtopod.predict import BetweenCameras, Predictor, Walks
from camtopod.predict.between import HORIZON_SECONDS
from camtopod.records import Between, Topology

STEP_SECONDS = 600.0
"""Time from one moment to the next, seconds."""
MOMENTS_MIN = 10
"""Least number of moments of a recording."""


_WAYS = f"{'ours':>11}{'balance':>11}{'zero':>11}"


class Result(Struct):
    """Figures of one network: means over its moments.

    truth, said: true and expected number of objects between cameras.
    error, coverage: absolute error, and share of moments at which the truth is covered: each of
        camtopod, of exits less entries, and of zero.
    """

    name: str
    moments: int
    truth: float
    said: float
    error: tuple[float, float, float]
    coverage: tuple[float, float, float]


def main(argv: Sequence[str]) -> int:
    """Measure, print the table and return the exit status."""
    parser = networks_parser(__name__, __doc__)
    results = results_of(parser.parse_args(argv), measure)
    if not results:
        return 0
    print(f"{'':46}{'mean absolute error':>33}{'coverage':>33}")
    print(f"{'network':20}{'moments':>8}{'truth':>9}{'expected':>9}" + 2 * _WAYS)
    for result in results:
        print(f"{result.name:20}{result.moments:8}{result.truth:9.2f}{result.said:9.2f}", end="")
        print(_cells(result.error + result.coverage))
    figures = np.array([result.error + result.coverage for result in results])
    means = figures.mean(axis=0)
    print(f"{'mean':46}" + _cells(means))
    for title, mean in zip(("error", "balance", "zero", "coverage"), means[:4], strict=True):
        print(line_of(title, float(mean)))
    if len(results) > 1:
        errors = figures.std(axis=0, ddof=1) / np.sqrt(len(results))
        print(f"{'standard error':46}" + _cells(errors))
    return 0


def _cells(figures: Iterable[float]) -> str:
    return "".join(f"{figure:11.2f}" for figure in figures)


def measure(folder: Path) -> Result:
    """Learn one network, and score the numbers between its cameras."""
    recording = load(folder)
    topology = learn_topology(event for event in recording.events if event.t < recording.cut)

    moments = moments_of(recording)
    since = recording.cut - HORIZON_SECONDS
    answers = replayed(topology, recording, since, moments)
    truth = truly_between(recording, since, moments)
    expected = np.array([answer.number for answer in answers])
    inside = [a.low <= n <= a.high for a, n in zip(answers, truth, strict=True)]
    balance = exits_less_entries(recording, since, moments)
    error = float(np.abs(expected - truth).mean())
    balance_error = float(np.abs(balance - truth).mean())
    return Result(
        recording.name,
        len(moments),
        float(truth.mean()),
        float(expected.mean()),
        (error, balance_error, float(truth.mean())),
        (float(np.mean(inside)), float(np.mean(balance == truth)), float(np.mean(truth == 0.0))),
    )


def moments_of(recording: Recording) -> Floats:
    """Return the moments (n,) at which objects are counted, seconds."""
    last = recording.end - recording.window
    step = min(STEP_SECONDS, (last - recording.cut) / MOMENTS_MIN)
    return np.arange(recording.cut, last, step)


def replayed(
    topology: Topology, recording: Recording, since: float, moments: Floats
) -> list[Between]:
    """Return the expected number of objects at each moment (n,), by the events before it."""
    predictor = Predictor(topology)
    walks = Walks(topology, predictor.prepared)
    between = BetweenCameras(since)
    answers: list[Between] = []
    for event in recording.events:
        if event.t < since:
            continue
        while len(answers) < len(moments) and (now := float(moments[len(answers)])) < event.t:
            horizon = min(HORIZON_SECONDS, recording.end - now)
            answers.append(between.expected(now, pairs_max=0, horizon=horizon))
        if len(answers) == len(moments):
            break
        for match in walks.revised(event.t):
            between.entered(match)
        if event.kind == "exit":
            between.left(predictor.answer(event))
        predictor.observe(event)
        if (first := walks.observe(event)) is not None:
            between.entered(first)
    return answers


def truly_between(recording: Recording, since: float, moments: Floats) -> Floats:
    """Return how many identities are between cameras at each moment (n,)."""
    number = np.zeros(len(moments))
    for passages in recording.by_identity:
        end = -np.inf  # of the passages so far
        for passage in passages:
            if end >= since and passage.begin > end:
                soon = passage.begin - moments <= HORIZON_SECONDS
                number += (end <= moments) & (moments < passage.begin) & soon
            end = max(end, passage.end)
    return number


def exits_less_entries(recording: Recording, since: float, moments: Floats) -> Floats:
    """Return the exits less the entries up to each moment (n,), but not less than zero."""
    events = [event for event in recording.events if event.t >= since]
    times = np.array([event.t for event in events])
    balance = np.cumsum([1 if event.kind == "exit" else -1 for event in events])
    before = np.searchsorted(times, moments, "right")
    number: Floats = np.maximum(np.append(0, balance)[before], 0).astype(float)
    return number
