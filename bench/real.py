"""Measure links and predictions on real networks with known identities.

    python -m bench real [--data FOLDER] [--networks a,b] [--jobs 2] [--json FILE] [--stretch F]
        [--labels car:.80,van:.12,bus:.08 [--seed N]] [--neighbours] [--nobody-leaves]

Each folder in ``--data`` (default: CAMTOPOD_REAL_DATA) with events.jsonl and identities.csv is a
network; without data the part is skipped. The first 70 % of the events are learned in one fit, as
`camtopod learn` does. Every exit is predicted with that version, as `camtopod predict` does, and
exits after the cut are scored. Counts of links are summed over the networks, the saving of a search
is a geometric mean, and all other figures are means over networks.

Beside camtopod are measured

* an oracle on the same zones, a Markov chain that is given the identities
* for links, the cross-correlation of cameras (Makris 2004), at the bin width and threshold that are
  best on these very networks, and pm4py's correlation miner, if it is installed
* for the next camera, if there is one, the rule of Area Occupancy Detection, with every pair of
  cameras as neighbours and with the true neighbours

``--stretch`` multiplies all times and stays, the window in which an exit is scored, and the time in
which an object is searched. With ``--labels`` each identity draws a label, which all its events
have. ``--neighbours`` declares the true neighbours to the learner, and all other pairs as not
neighbours; ``--nobody-leaves`` declares a closed site. Neither labels nor declarations change the
oracle, or which links the events can tell.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Sequence
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from msgspec import Struct

from bench.support.beside import (
    WHO,
    FollowingFigures,
    MinedFigures,
    following_figures,
    mined_figures,
)
from bench.support.figures import line_of
from bench.support.match_figures import who_figures
from bench.support.parts import networks_parser, results_of
from bench.support.real_figures import (
    SEARCH_RECALLS,
    TELLABLE_NATS,
    LinkFigures,
    PredictionFigures,
    calibration_error,
    hand_over_figure,
    link_figures,
    look_figures,
    prediction_figures,
)
from bench.support.real_options import Options, add_options, options_of, settings_of, with_labels
from bench.support.recordings import SPURIOUS_TRANSITIONS_MAX, CameraPair, Recording, load, tellable
from camtopod.learn.learner import Learner
from camtopod.predict.predictor import Predictor

WIDTHS_SECONDS = (1.0, 2.0, 4.0, 8.0)
"""Bin widths of the cross-correlation, seconds."""
LAGS_SECONDS = (-60.0, 180.0)
"""Range of lags of the cross-correlation, seconds."""
DEFAULTS = Options()
"""Recordings as they are; the learner is told nothing of their sites."""


class Result(Struct):
    """Figures of one network."""

    name: str
    options: Options
    links: LinkFigures
    ours: PredictionFigures | None
    told: PredictionFigures | None
    look: float
    told_look: float
    hand_over: float
    who: float
    told_who: float
    correlated: list[list[tuple[float, bool, bool]]]
    """By bin width, of every camera pair: score, whether it is a true link, whether it counts as
    false.
    """
    learn_seconds: float
    """Processor time of learning, seconds."""
    predict_seconds: float
    """Processor time of all predictions, seconds."""
    mined: MinedFigures | None
    following: list[FollowingFigures]
    """Of the next camera, given that there is one: by each of `WHO`."""


def main(argv: Sequence[str]) -> int:
    """Measure, print the tables and return the exit status."""
    parser = networks_parser(__name__, __doc__)
    add_options(parser)
    arguments = parser.parse_args(argv)
    options = options_of(arguments)
    results = results_of(arguments, partial(measure, options=options))
    if results:
        tables = [*_links(results), "", *_predictions(results), "", *_beside(results)]
        print("\n".join([f"options: {options.line()}", "", *tables]))
    return 0


def measure(folder: Path, options: Options = DEFAULTS, *, beside: bool = True) -> Result:
    """Learn one network, predict its exits and score both.

    beside: whether others (`bench.support.beside`, `correlated`) are measured beside us.
    """
    recording = with_labels(load(folder, options.stretch), options.labels, options.seed)
    learner = Learner(settings_of(options, recording), only_last=True)
    start = time.process_time()
    for event in recording.events:
        if event.t < recording.cut:
            learner.receive(event)
    learner.flush()
    assert learner.topology is not None
    learn_seconds = time.process_time() - start

    # Predict all exits.
    start = time.process_time()
    predictor = Predictor(learner.topology)
    predictions = []
    for event in recording.events:
        if event.kind == "exit":
            predictions.append(predictor.answer(event))
        predictor.observe(event)
    predict_seconds = time.process_time() - start

    # Score.
    ours, oracle = prediction_figures(predictions, recording) or (None, None)
    look, oracle_look = look_figures(predictions, recording)
    return Result(
        recording.name,
        options,
        link_figures(learner.topology, recording, _evidence(folder, options.stretch)),
        ours,
        oracle,
        look,
        oracle_look,
        hand_over_figure(predictions, recording),
        *who_figures(learner.topology, predictions, recording),
        [correlated(recording, width) for width in WIDTHS_SECONDS] if beside else [],
        learn_seconds,
        predict_seconds,
        mined_figures(recording) if beside else None,
        following_figures(predictions, recording) if beside else [],
    )


@lru_cache(maxsize=1)
def _evidence(folder: Path, stretch: float) -> dict[CameraPair, float]:
    """Return the evidence of each true link; kept, as `bench.ablation` asks again and again."""
    return tellable(load(folder, stretch))


def correlated(recording: Recording, width: float) -> list[tuple[float, bool, bool]]:
    """Return the peak of each camera pair's cross-correlation above its mean, in standard
    deviations.

    With it: whether the pair is a true link, and whether a link of the pair would count as false.
    """
    times: dict[tuple[str, str], list[float]] = defaultdict(list)
    for event in recording.events:
        if event.t < recording.cut:
            times[event.camera, event.kind].append(event.t)

    # Score each pair of cameras.
    edges = recording.stretch * np.arange(LAGS_SECONDS[0], LAGS_SECONDS[1] + width / 2, width)
    links, transitions = recording.links(), recording.transitions()
    scores = []
    for source in recording.cameras:
        for target in recording.cameras:
            if source == target:
                continue
            lags = np.subtract.outer(times[target, "entry"], times[source, "exit"]).ravel()
            counts = np.histogram(lags, edges)[0]
            score = -np.inf
            if counts.sum() >= 3:
                score = (counts.max() - counts.mean()) / max(float(counts.std()), 1e-9)
            pair: CameraPair = source, target
            spurious = len(transitions.get(pair, [])) <= SPURIOUS_TRANSITIONS_MAX
            scores.append((float(score), pair in links, spurious))
    return scores


def best_correlation(results: Sequence[Result]) -> tuple[float, float]:
    """Return precision and recall over all networks at the width and threshold with the best F1."""
    true = sum(result.links.true for result in results)
    best = (0.0, 0.0, 0.0)
    for width in range(len(WIDTHS_SECONDS)):
        rows = sorted((row for result in results for row in result.correlated[width]), reverse=True)
        right = np.cumsum([is_true for _, is_true, _ in rows])
        false = np.cumsum([spurious for _, _, spurious in rows])
        precision = right / np.maximum(right + false, 1)
        recall = right / max(true, 1)
        f1 = 2 * precision * recall / np.maximum(precision + recall, 1e-9)
        k = int(np.argmax(f1))
        best = max(best, (float(f1[k]), float(precision[k]), float(recall[k])))
    return best[1], best[2]


def _links(results: Sequence[Result]) -> list[str]:
    """Return the table of links."""
    titles = [f"of those at {least:g} nats" for least in TELLABLE_NATS]
    columns = ("true", "found", "false", *titles, "relations right", "transit off by")
    lines = [_row("links between cameras", *columns)]
    for result in results:
        f = result.links
        counts = [f"{f.found[least]} of {f.can_be_told[least]}" for least in TELLABLE_NATS]
        cells = (*counts, f"{f.relations_right} of {f.relations}", f"{f.transit_error:.1f} s")
        lines.append(_row(result.name, f.true, f.right, f.false, *cells))

    # All networks together.
    figures = [result.links for result in results]
    true, right, false = (
        sum(getattr(f, name) for f in figures) for name in ("true", "right", "false")
    )
    relations = f"{sum(f.relations_right for f in figures)} of {sum(f.relations for f in figures)}"
    counts, shares = [], []
    for least in TELLABLE_NATS:
        hits = sum(f.found[least] for f in figures)
        tellable_links = sum(f.can_be_told[least] for f in figures)
        share = hits / max(tellable_links, 1)
        counts.append(f"{hits} of {tellable_links}: {share:.2f}")
        shares.append(line_of(f"links of those at {least:g} nats", share))
    recall_text = f"{right}: {right / max(true, 1):.2f}"
    lines.append(_row("all", true, recall_text, false, *counts, relations, ""))

    # Beside it the cross-correlation.
    precision, recall = best_correlation(results)
    lines += [
        line_of("links published", right + false),
        line_of("false links", false),
        line_of("links of all", right / max(true, 1)),
        *shares,
        f"precision {right / max(right + false, 1):.2f}",
        f"cross-correlation at its best threshold: recall {recall:.2f}, precision {precision:.2f}",
    ]
    return lines


def _predictions(results: Sequence[Result]) -> list[str]:
    """Return the table of predictions, ours / oracle."""
    columns = (*_COMPARED.values(), "look", "hand-over (ours)", "saved at .9", "who")
    lines = [_row("ours / oracle", "exits", *columns, "leaving said", "leaving true")]
    pairs = []
    for result in results:
        ours, oracle = result.ours, result.told
        if ours is None or oracle is None:
            continue
        pairs.append((ours, oracle))
        cells = [f"{getattr(ours, name):.2f}/{getattr(oracle, name):.2f}" for name in _COMPARED]
        cells += [f"{result.look:.2f}/{result.told_look:.2f}", f"{result.hand_over:.2f}"]
        cells.append(f"{ours.saved[0.9]:.1f}/{oracle.saved[0.9]:.1f}" if ours.saved else "")
        cells.append(f"{result.who:.2f}/{result.told_who:.2f}")
        cells += [f"{ours.leaving:.2f}/{oracle.leaving:.2f}", f"{ours.left:.2f}"]
        lines.append(_row(result.name, ours.exits, *cells))
    return lines + _prediction_means(results, pairs)


def _prediction_means(
    results: Sequence[Result], pairs: Sequence[tuple[PredictionFigures, PredictionFigures]]
) -> list[str]:
    """Return the figures of predictions of all networks together.

    pairs: our figures and the oracle's, of the networks with exits to score.
    """
    above = np.mean([ours.log_loss - oracle.log_loss for ours, oracle in pairs])
    leave = np.mean([ours.leave_loss - oracle.leave_loss for ours, oracle in pairs])
    top1 = np.mean([ours.top1 / oracle.top1 for ours, oracle in pairs])
    top3 = np.mean([ours.top3 / oracle.top3 for ours, oracle in pairs])
    calibration = [_pooled_calibration([pair[side] for pair in pairs]) for side in (0, 1)]
    savings = []
    for recall in SEARCH_RECALLS:
        shares = [o.saved[recall] / t.saved[recall] for o, t in pairs if o.saved]
        savings.append(f"{np.exp(np.mean(np.log(shares))):.2f} at recall {recall:g}")
    who = [result.who / result.told_who for result in results if result.told_who > 0]
    learn_seconds = sum(result.learn_seconds for result in results)
    predict_seconds = sum(result.predict_seconds for result in results)
    off = [abs(ours.leaving - ours.left) for ours, _ in pairs]
    return [
        line_of("log loss above the oracle", float(above)),
        line_of("leaving off by", float(np.mean(off))),
        f"log loss above the oracle's {above:.3f}, of it leaving {leave:.3f}",
        f"probability of leaving, mean of a network: off by {np.mean(off):.2f}, at most "
        f"{max(off, default=float('nan')):.2f}",
        f"top-1 and top-3, share of the oracle's: {top1:.2f}, {top3:.2f}",
        "calibration error of the first guess, all exits together: {:.3f}, oracle {:.3f}".format(
            *calibration
        ),
        f"camera-seconds saved, share of the oracle's: {', '.join(savings)}",
        "matches by affinity, F1 as a share of the oracle's: "
        f"{np.mean(who) if who else float('nan'):.2f}",
        f"processor time: learning {learn_seconds:.1f} s, predicting {predict_seconds:.1f} s",
    ]


def _pooled_calibration(figures: Sequence[PredictionFigures]) -> float:
    """Return the calibration error of the first guess over the exits of all networks."""
    confidence = [value for f in figures for value in f.confidence]
    return calibration_error(confidence, [is_right for f in figures for is_right in f.right])


def _beside(results: Sequence[Result]) -> list[str]:
    """Return the tables of others beside us: links that are mined, and the next camera by rule."""
    lines = [_row("correlation miner", "true", "found", "false", "mean way off by")]
    miner = {result.name: result.mined for result in results if result.mined is not None}
    for name, f in miner.items():
        lines.append(_row(name, f.true, f.right, f.false, f"{f.transit_error:.1f} s"))
    lines += [
        line_of("miner, links right", sum(f.right for f in miner.values())),
        line_of("miner, false links", sum(f.false for f in miner.values())),
    ]
    if not miner:
        lines.append("skipped: the miner is pm4py's (AGPL), pip install -e '.[bench]'")

    # The next camera.
    ours, *rules = WHO
    if any(result.options.neighbours for result in results):
        ours += ", told"
    lines += ["", _row("next camera: loss/top-1", "exits", ours, *rules)]
    rows = [result.following for result in results if result.following]
    for result in results:
        if result.following:
            cells = [f"{f.log_loss:.2f}/{f.top1:.2f}" for f in result.following]
            lines.append(_row(result.name, result.following[0].exits, *cells))
    lower = {
        rule: sum(row[k].log_loss < row[0].log_loss for row in rows)
        for k, rule in enumerate(rules, 1)
    }
    counts = "; ".join(f"{rule} {number} of {len(rows)}" for rule, number in lower.items())
    lines.append(f"networks on which the log loss is lower than that of {ours}: {counts}")
    lines.append(line_of("networks asked", len(rows)))
    lines += [line_of(f"networks with lower log loss, {rule}", n) for rule, n in lower.items()]
    return lines


_COMPARED = {
    "log_loss": "log loss",
    "leave_loss": "its leave part",
    "top1": "top-1",
    "top3": "top-3",
    "calibration_error": "calibration error",
    "coverage": "coverage",
}
"""Titles of the figures that are compared with the oracle's, in order."""


def _row(title: str, *cells: object) -> str:
    return "  ".join([f"{title:24}", *(f"{cell!s:>17}" for cell in cells)])
