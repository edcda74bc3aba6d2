"""Measure the learner on simulated networks: topology, predictions and time.

    python -m bench learn [--seeds N] [--first-seed S] [--cameras N] [--hours H] [--json FILE]

A network has 12 cameras, 10 % missed passages and 10 % clutter; 1.7 hours are about 20,000 events.
They are fed one by one, as `camtopod learn` does. Predictions come from a learner that received the
first 70 % of the events and are scored on the rest. An oracle is scored beside it: a Markov chain
over the true zones, given the identities in those 70 %.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct

from camtopod.codec import to_json
from camtopod.learn.learner import Learner
from camtopod.predict.predictor import Predictor
from camtopod.records import Event, NextCamera, Prediction, Topology
from camtopod.sim.scoring import next_entries, score, score_predictions
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.sim.truth import CLUTTER, Truth

TRAIN_SHARE = 0.7
"""Share of the events that are learned before predictions on the rest are scored."""


class Row(Struct):
    """Figures of one network; errors are fractions, log losses nats."""

    seed: int
    events: int
    cameras_right: float
    """Share of the cameras with exactly their true zones."""
    zones_true: int
    zones_found: int
    zones_learned: int
    link_precision: float
    link_recall: float
    relations_right: float
    """Share of the right links whose relation (overlapped or unseen) is right."""
    pair_precision: float
    pair_recall: float
    mode_error: float
    mean_error: float
    top1: float
    top3: float
    log_loss: float
    told_top1: float
    told_top3: float
    told_log_loss: float
    versions: int
    seconds: float
    """Wall time of learning all events and making every version, seconds."""


COLUMNS = {
    "cameras_right": "cameras right",
    "zones_true": "zones true",
    "zones_found": "zones found",
    "zones_learned": "zones learned",
    "link_precision": "link precision",
    "link_recall": "link recall",
    "relations_right": "relation right",
    "pair_precision": "pair precision",
    "pair_recall": "pair recall",
    "mode_error": "transit error, mode",
    "mean_error": "transit error, mean",
    "top1": "next camera, top-1",
    "top3": "next camera, top-3",
    "log_loss": "log loss, nats",
    "told_top1": "oracle, top-1",
    "told_top3": "oracle, top-3",
    "told_log_loss": "oracle, log loss, nats",
    "events": "events",
    "versions": "versions",
    "seconds": "seconds",
}
"""Titles of the figures in the table."""


def main(argv: list[str]) -> int:
    """Print a column for each network, then mean and standard deviation; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m bench learn")
    parser.add_argument("--seeds", type=int, default=3, help="number of networks (default 3)")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--cameras", type=int, default=12)
    parser.add_argument("--hours", type=float, default=1.7)
    parser.add_argument(
        "--json", type=Path, metavar="FILE", help="write the figures of every network to this file"
    )
    arguments = parser.parse_args(argv)
    rows = []
    for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds):
        rows.append(
            measure(SimSettings(cameras=arguments.cameras, hours=arguments.hours, seed=seed))
        )
        print(f"seed {seed}: {rows[-1].events} events in {rows[-1].seconds:.1f} s", flush=True)
    print("\n".join(table(rows)))
    if arguments.json:
        arguments.json.write_bytes(msgspec.json.format(to_json(rows), indent=1) + b"\n")
    return 0


def measure(settings: SimSettings) -> Row:
    """Simulate one network, learn it, and score its topology and predictions."""
    events, truth = simulate(settings)
    started = time.perf_counter()
    topology = learn(events)
    seconds = time.perf_counter() - started
    result = score(topology, truth)
    cut = int(TRAIN_SHARE * len(events))
    tail = msgspec.structs.replace(
        truth, identity=truth.identity[cut:], passage=truth.passage[cut:], zone=truth.zone[cut:]
    )
    ours = score_predictions(predict(learn(events[:cut]), events, cut), events[cut:], tail)
    told = score_predictions(oracle_predictions(events, truth, cut), events[cut:], tail)
    return Row(
        seed=settings.seed,
        events=len(events),
        cameras_right=result.cameras_right / result.cameras,
        zones_true=result.zones_true,
        zones_found=result.zones_matched,
        zones_learned=result.zones_learned,
        link_precision=result.link_precision,
        link_recall=result.link_recall,
        relations_right=result.relations_right / max(result.links_right, 1),
        pair_precision=result.pair_precision,
        pair_recall=result.pair_recall,
        mode_error=result.mode_error,
        mean_error=result.mean_error,
        top1=ours.top1,
        top3=ours.top3,
        log_loss=ours.log_loss,
        told_top1=told.top1,
        told_top3=told.top3,
        told_log_loss=told.log_loss,
        versions=topology.version,
        seconds=seconds,
    )


def learn(events: Sequence[Event]) -> Topology:
    """The last version, events fed as `camtopod learn` feeds them."""
    learner = Learner()
    for event in events:
        learner.receive(event)
        learner.updates()
    learner.flush()
    assert learner.topology is not None
    return learner.topology


def predict(topology: Topology, events: Sequence[Event], cut: int) -> list[Prediction]:
    """Predict each exit from event ``cut`` on, having observed every event before it."""
    predictor = Predictor(topology)
    predictions = []
    for index, event in enumerate(events):
        if index >= cut and event.kind == "exit":
            predictions.append(predictor.predict(event))
        predictor.observe(event)
    return predictions


def oracle_predictions(events: Sequence[Event], truth: Truth, cut: int) -> list[Prediction]:
    """Predict the same exits by the oracle: counts per true zone of the next camera before ``cut``.

    Clutter is not counted.
    """
    following: dict[int, Counter[str]] = {}
    for index, entry in enumerate(next_entries(events, truth)[:cut]):
        if entry < cut and events[index].kind == "exit" and truth.identity[index] != CLUTTER:
            camera = events[entry].camera if entry >= 0 else ""
            following.setdefault(truth.zone[index], Counter())[camera] += 1

    # Predict from the shares of each zone.
    predictions = []
    for index in range(cut, len(events)):
        event = events[index]
        if event.kind == "exit":
            counts = following.get(truth.zone[index], Counter())
            share = {camera: n / counts.total() for camera, n in counts.items()}
            leave = share.pop("", 0.0)
            choices = [NextCamera(camera, "", p, 0.0, 0.0, 0.0) for camera, p in share.items()]
            predictions.append(Prediction(event.camera, None, event.t, None, 0, leave, choices))
    return predictions


def table(rows: list[Row]) -> list[str]:
    """Return one line a figure: a column a network, then mean and standard deviation."""
    lines = [
        " " * 26 + "".join(f"{f'seed {row.seed}':>10}" for row in rows) + f"{'mean':>12}{'sd':>10}"
    ]
    for name, title in COLUMNS.items():
        values = np.array([getattr(row, name) for row in rows], dtype=float)
        digits = 0 if all(isinstance(getattr(row, name), int) for row in rows) else 3
        shown = "".join(f"{value:>10.{digits}f}" for value in values)
        spread = f"{values.std(ddof=1):>10.3f}" if len(values) > 1 else f"{'-':>10}"
        lines.append(f"{title:26}{shown}{values.mean():>12.3f}{spread}")
    return lines
