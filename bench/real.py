"""Measure links and predictions on real networks with known identities.

    python -m bench real [--data FOLDER] [--networks a,b] [--jobs 2] [--json FILE] [--stretch F]
        [--labels car:.80,van:.12,bus:.08 [--seed N]] [--neighbours] [--nobody-leaves]

Each folder in ``--data`` (default: CAMTOPOD_REAL_DATA) with events.jsonl and identities.csv is a
network; without data the part is skipped. The first 70 % of the events are learned in one fit, as
`camtopod learn` does. Every exit is predicted with that, as `camtopod predict` does, and those
after the cut are scored. Compared are an oracle (a Markov chain that is given the identities) on
the same zones, and for links the cross-correlation of cameras (Makris 2004) at the bin width and
threshold that are best on these very networks. Beside both is pm4py's correlation miner, if it is
installed, and for the next camera, given that there is one, the rule of Area Occupancy Detection,
with every pair of cameras and told the true neighbours. Links are pooled over the networks, the
saving of a search is a geometric mean, all else are plain means.

With ``--stretch`` all times and stays grow by a factor, and with them the window in which an exit
is scored and the time in which it is searched. With ``--labels`` each identity draws a label, which
all its events have. With ``--neighbours`` the learner is told the true neighbours and that no other
cameras are, with ``--nobody-leaves`` that the site is closed. The oracle and what the events can
tell are as without labels and declarations.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from msgspec import Struct, to_builtins

from bench.support.beside import (
    WHO,
    FollowingFigures,
    MinedFigures,
    following_figures,
    mined_figures,
)
from bench.support.figures import line_of
from bench.support.jobs import map_tasks
from bench.support.match_figures import who_figures
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


class Task(Struct, frozen=True):
    """A network to measure: its folder and the options.

    beside: whether others (`bench.support.beside`) are measured beside us.
    """

    folder: Path
    options: Options = Options()
    beside: bool = True


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
    arguments = _parse(argv)
    folders = (
        sorted(path.parent for path in arguments.data.glob("*/identities.csv"))
        if arguments.data
        else []
    )
    wanted = (
        arguments.networks.split(",") if arguments.networks else [folder.name for folder in folders]
    )
    folders = [folder for folder in folders if folder.name in wanted]
    if not folders:
        print("bench real: skipped, no recordings found (set --data or CAMTOPOD_REAL_DATA)")
        return 0
    os.environ.setdefault(
        "OMP_NUM_THREADS", "1"
    )  # inherited by the workers: two of them share two cores

    # Measure and report.
    options = options_of(arguments)
    tasks = [Task(folder, options) for folder in folders]
    results = map_tasks(measure, tasks, arguments.jobs)
    tables = [*_links(results), "", *_predictions(results), "", *_beside(results)]
    print("\n".join([f"options: {options.line()}", "", *tables]))
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(to_builtins(results, str_keys=True), indent=1) + "\n")
    return 0


def measure(task: Task) -> Result:
    """Learn one network, predict its exits and score both."""
    options = task.options
    recording = with_labels(load(task.folder, options.stretch), options.labels, options.seed)
    learner = Learner(settings_of(options, recording), only_last=True)
    started = time.process_time()
    for event in recording.events:
        if event.t < recording.cut:
            learner.receive(event)
    learner.flush()
    assert learner.topology is not None
    learned = time.process_time()

    # Predict all exits.
    predictor, predictions = Predictor(learner.topology), []
    for event in recording.events:
        if event.kind == "exit":
            predictions.append(predictor.predict(event))
        predictor.observe(event)
    predicted = time.process_time()

    # Score.
    ours, told = prediction_figures(predictions, recording) or (None, None)
    look, told_look = look_figures(predictions, recording)
    return Result(
        recording.name,
        options,
        link_figures(learner.topology, recording, tellable(recording)),
        ours,
        told,
        look,
        told_look,
        hand_over_figure(predictions, recording),
        *who_figures(learner.topology, predictions, recording),
        [correlated(recording, width) for width in WIDTHS_SECONDS],
        learned - started,
        predicted - learned,
        mined_figures(recording) if task.beside else None,
        following_figures(predictions, recording) if task.beside else [],
    )


def correlated(recording: Recording, width: float) -> list[tuple[float, bool, bool]]:
    """Return the peak of each camera pair's cross-correlation above its mean, in standard
    deviations.

    With it: whether the pair is a true link, and whether a link of the pair would count as false.
    """
    left: dict[str, list[float]] = {camera: [] for camera in recording.cameras}
    came: dict[str, list[float]] = {camera: [] for camera in recording.cameras}
    for event in recording.events:
        if event.t < recording.cut:
            (came if event.kind == "entry" else left)[event.camera].append(event.t)

    # Score each pair of cameras.
    edges = recording.stretch * np.arange(LAGS_SECONDS[0], LAGS_SECONDS[1] + width / 2, width)
    links, transitions = recording.links(), recording.transitions()
    scores = []
    for source in recording.cameras:
        for target in recording.cameras:
            if source == target:
                continue
            lags = np.subtract.outer(np.array(came[target]), np.array(left[source])).ravel()
            counts = np.histogram(lags, edges)[0]
            score = (
                (counts.max() - counts.mean()) / max(float(counts.std()), 1e-9)
                if counts.sum() >= 3
                else -np.inf
            )
            pair: CameraPair = source, target
            spurious = len(transitions.get(pair, [])) <= SPURIOUS_TRANSITIONS_MAX
            scores.append((float(score), pair in links, spurious))
    return scores


def best_correlation(results: Sequence[Result]) -> tuple[float, float]:
    """Return precision and recall over all networks at the width and threshold with the best F1."""
    true = sum(one.links.true for one in results)
    best = (0.0, 0.0, 0.0)
    for width in range(len(WIDTHS_SECONDS)):
        rows = sorted((row for one in results for row in one.correlated[width]), reverse=True)
        right = np.cumsum([is_true for _, is_true, _ in rows])
        false = np.cumsum([spurious for _, _, spurious in rows])
        precision, recall = right / np.maximum(right + false, 1), right / max(true, 1)
        f1 = 2 * precision * recall / np.maximum(precision + recall, 1e-9)
        k = int(np.argmax(f1))
        best = max(best, (float(f1[k]), float(precision[k]), float(recall[k])))
    return best[1], best[2]


def _links(results: Sequence[Result]) -> list[str]:
    """Return the table of links."""
    titles = [f"of those at {least:g} nats" for least in TELLABLE_NATS]
    lines = [
        _row(
            "links between cameras",
            "true",
            "found",
            "false",
            *titles,
            "relations right",
            "transit off by",
        )
    ]
    for one in results:
        f = one.links
        told = [f"{f.found[least]} of {f.can_be_told[least]}" for least in TELLABLE_NATS]
        relations = f"{f.relations_right} of {f.relations}"
        lines.append(
            _row(one.name, f.true, f.right, f.false, *told, relations, f"{f.transit_error:.1f} s")
        )

    every = [one.links for one in results]
    right, false, true, relations_right, relations_all = (
        sum(getattr(f, name) for f in every)
        for name in ("right", "false", "true", "relations_right", "relations")
    )
    told, shares = [], []
    for least in TELLABLE_NATS:
        found, can = sum(f.found[least] for f in every), sum(f.can_be_told[least] for f in every)
        told.append(f"{found} of {can}: {found / max(can, 1):.2f}")
        shares.append(line_of(f"links of those at {least:g} nats", found / max(can, 1)))
    found_of_all = f"{right}: {right / max(true, 1):.2f}"
    lines.append(
        _row("all", true, found_of_all, false, *told, f"{relations_right} of {relations_all}", "")
    )

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
    titles = (
        "log loss",
        "its leave part",
        "top-1",
        "top-3",
        "calibration error",
        "coverage",
        "look",
    )
    last = ("hand-over (ours)", "saved at .9", "who", "leaving said", "leaving true")
    lines = [_row("ours / oracle", "exits", *titles, *last)]
    judged = [
        (one, one.ours, one.told)
        for one in results
        if one.ours is not None and one.told is not None
    ]
    for one, ours, told in judged:
        figures = [f"{getattr(ours, name):.2f}/{getattr(told, name):.2f}" for name in _COMPARED]
        saved = f"{ours.saved[0.9]:.1f}/{told.saved[0.9]:.1f}" if ours.saved else ""
        look = f"{one.look:.2f}/{one.told_look:.2f}"
        lines.append(
            _row(
                one.name,
                ours.exits,
                *figures,
                look,
                f"{one.hand_over:.2f}",
                saved,
                f"{one.who:.2f}/{one.told_who:.2f}",
                f"{ours.leaving:.2f}/{told.leaving:.2f}",
                f"{ours.left:.2f}",
            )
        )
    return lines + _prediction_means(results, judged)


def _prediction_means(
    results: Sequence[Result], judged: Sequence[tuple[Result, PredictionFigures, PredictionFigures]]
) -> list[str]:
    """Return the figures of predictions of all networks together.

    judged: networks with exits to score, with our figures and the oracle's.
    """
    above, leave = (
        np.mean([getattr(ours, name) - getattr(told, name) for _, ours, told in judged])
        for name in ("log_loss", "leave_loss")
    )
    top1, top3 = (
        np.mean([getattr(ours, name) / getattr(told, name) for _, ours, told in judged])
        for name in ("top1", "top3")
    )
    calibration = [
        calibration_error(
            [c for f in side for c in f.confidence], [r for f in side for r in f.right]
        )
        for side in ([ours for _, ours, _ in judged], [told for _, _, told in judged])
    ]
    saved_of = {
        recall: np.exp(
            np.mean([np.log(o.saved[recall] / t.saved[recall]) for _, o, t in judged if o.saved])
        )
        for recall in SEARCH_RECALLS
    }
    who = [one.who / one.told_who for one in results if one.told_who > 0]
    seconds = [
        sum(getattr(one, name) for one in results) for name in ("learn_seconds", "predict_seconds")
    ]
    off = [abs(ours.leaving - ours.left) for _, ours, _ in judged]
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
        "camera-seconds saved, share of the oracle's: "
        + ", ".join(f"{s:.2f} at recall {r:g}" for r, s in saved_of.items()),
        "matches by affinity, F1 as a share of the oracle's: "
        f"{np.mean(who) if who else float('nan'):.2f}",
        "processor time: learning {:.1f} s, predicting {:.1f} s".format(*seconds),
    ]


def _beside(results: Sequence[Result]) -> list[str]:
    """Return the tables of others beside us: links that are mined, and the next camera by rule."""
    lines = [_row("correlation miner", "true", "found", "false", "mean way off by")]
    mined = [(one.name, one.mined) for one in results if one.mined is not None]
    lines += [_row(name, f.true, f.right, f.false, f"{f.transit_error:.1f} s") for name, f in mined]
    lines += [
        line_of("miner, links right", sum(f.right for _, f in mined)),
        line_of("miner, false links", sum(f.false for _, f in mined)),
    ]
    if not mined:
        lines.append("skipped: the miner is pm4py's (AGPL), pip install -e '.[bench]'")

    # The next camera.
    ours, *others = WHO
    ours += ", told" * any(one.options.neighbours for one in results)
    lines += ["", _row("next camera: loss/top-1", "exits", ours, *others)]
    asked = [one for one in results if one.following]
    for one in asked:
        figures = [f"{f.log_loss:.2f}/{f.top1:.2f}" for f in one.following]
        lines.append(_row(one.name, one.following[0].exits, *figures))
    lower = [
        sum(one.following[k].log_loss < one.following[0].log_loss for one in asked)
        for k in range(1, len(WHO))
    ]
    said = "; ".join(f"{who} {n} of {len(asked)}" for who, n in zip(others, lower, strict=True))
    lines.append(f"networks on which the log loss is lower than that of {ours}: {said}")
    lines.append(line_of("networks asked", len(asked)))
    lines += [
        line_of(f"networks with lower log loss, {who}", n)
        for who, n in zip(others, lower, strict=True)
    ]
    return lines


_COMPARED = ("log_loss", "leave_loss", "top1", "top3", "calibration_error", "coverage")
"""Figures of the table of predictions, in order."""


def _row(title: str, *cells: object) -> str:
    return "  ".join([f"{title:24}", *(f"{cell!s:>17}" for cell in cells)])


def networks_parser(part: str, what: str) -> argparse.ArgumentParser:
    """Return a parser with the options of a bench over real networks."""
    named = os.environ.get("CAMTOPOD_REAL_DATA")
    parser = argparse.ArgumentParser(
        prog=f"python -m bench {part}", description=f"Measure {what} on real networks."
    )
    parser.add_argument(
        "--data", type=Path, default=Path(named) if named else None, metavar="FOLDER"
    )
    parser.add_argument("--networks", help="comma-separated (default: all)")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default 2)")
    return parser


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = networks_parser("real", "links and predictions")
    parser.add_argument("--json", type=Path, metavar="FILE")
    add_options(parser)
    return parser.parse_args(argv)
