"""Options of `bench real`: how recordings are changed, and what the learner is told of the site."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from itertools import combinations

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from bench.support.recordings import Recording
from camtopod.labels import plain
from camtopod.learn.settings import Settings, TopologySettings

ROUNDING = 1e-9
"""By what shares that were meant to make 1 together may exceed it."""


class Options(Struct, frozen=True):
    """Options of `bench real`.

    stretch: factor by which all times and stays grow.
    labels: share of the identities that draw each label; the others have none.
    seed: of the drawing of labels.
    neighbours: whether the true neighbours are declared, and the other pairs as none.
    nobody_leaves: whether the site is declared as closed.
    """

    stretch: float = 1.0
    labels: dict[str, float] = {}
    seed: int = 0
    neighbours: bool = False
    nobody_leaves: bool = False

    def line(self) -> str:
        """Return the options as they were given; "none" if all are the defaults."""
        words = [f"--stretch {self.stretch:g}"] if self.stretch != 1.0 else []
        if self.labels:
            shares = ",".join(f"{label}:{share:g}" for label, share in self.labels.items())
            words.append(f"--labels {shares} --seed {self.seed}")
        words += ["--neighbours"] * self.neighbours + ["--nobody-leaves"] * self.nobody_leaves
        return " ".join(words) or "none"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options to a parser; `options_of` reads them."""
    parser.add_argument(
        "--stretch", type=float, default=1.0, help="factor of all times and stays (default 1)"
    )
    parser.add_argument(
        "--labels",
        type=label_shares,
        default={},
        metavar="LABEL:SHARE,...",
        help="labels that the identities draw, such as car:.80,van:.12; the others have none",
    )
    parser.add_argument("--seed", type=int, default=0, help="of the labels drawn (default 0)")
    parser.add_argument(
        "--neighbours",
        action="store_true",
        help="declare the true neighbours, and all other pairs of cameras as not neighbours",
    )
    parser.add_argument("--nobody-leaves", action="store_true", help="declare a closed site")


def options_of(arguments: argparse.Namespace) -> Options:
    """Return the options of parsed arguments."""
    return Options(**{name: getattr(arguments, name) for name in Options.__struct_fields__})


def label_shares(text: str) -> dict[str, float]:
    """Return the shares of an option such as ``car:.80,van:.12``.

    Raises `argparse.ArgumentTypeError` if it is no such option.
    """
    shares: dict[str, float] = {}
    for part in text.split(","):
        name, _, number = part.partition(":")
        label = plain(name)
        try:
            share = float(number)
        except ValueError:
            share = -1.0
        if not label or label in shares or not 0.0 < share <= 1.0:
            raise argparse.ArgumentTypeError(f"{part!r} is no new LABEL:SHARE, share up to 1")
        shares[label] = share
    if sum(shares.values()) > 1.0 + ROUNDING:
        raise argparse.ArgumentTypeError(f"the shares of {text!r} are more than 1 together")
    return shares


def with_labels(recording: Recording, shares: Mapping[str, float], seed: int) -> Recording:
    """Return the recording with a label drawn by each identity, on all events of its passages.

    Identities draw in the order of their first passages.
    """
    if not shares:
        return recording
    limits, names = np.cumsum([*shares.values()]), [*shares, None]
    draws = np.random.default_rng(seed).random(len(recording.by_identity))
    label = {
        passage.track: names[k]
        for passages, k in zip(
            recording.by_identity, np.searchsorted(limits, draws, side="right"), strict=True
        )
        for passage in passages
    }
    return replace(
        recording,
        events=[replace(event, label=label[str(event.track)]) for event in recording.events],
    )


def settings_of(options: Options, recording: Recording) -> Settings:
    """Return the learner's settings, with what is declared of the recording's site.

    Neighbours are the pairs with a true link before the cut, in either direction, as the rule of
    `baselines.area_occupancy` is told them (by direction); all other pairs are not neighbours.
    """
    if not options.neighbours:
        return Settings(topology=TopologySettings(nobody_leaves=options.nobody_leaves))
    all_pairs = set(combinations(recording.cameras, 2))  # each pair in the order of names
    neighbours = {(min(pair), max(pair)) for pair in recording.links()}
    return Settings(
        topology=TopologySettings(
            tuple(sorted(neighbours)), tuple(sorted(all_pairs - neighbours)), options.nobody_leaves
        )
    )
