"""Simulate a scene that is not a network of zones and paths: events and ground truth.

    python -m bench scene {hall,crowd,walkway,road} --events E.jsonl [--truth T.json]
                          [--cameras N] [--seconds S] [--seed N]

The scenes are a station hall, a crowded square, the walkways of a campus and the streets of a town.
`camtopod simulate` simulates networks.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from msgspec import Struct

from bench.scenes.crowd import CrowdSettings, simulate_crowd
from bench.scenes.hall import HallSettings, simulate_hall
from bench.scenes.road import RoadSettings, simulate_road
from bench.scenes.walkway import WalkwaySettings, simulate_walkway
from bench.support.parts import part_parser
from camtopod.codec import to_json
from camtopod.records import Event
from camtopod.sim.truth import Truth

SCENES: dict[str, tuple[type[Struct], Callable[[Any], tuple[list[Event], Truth]]]] = {
    "hall": (HallSettings, simulate_hall),
    "crowd": (CrowdSettings, simulate_crowd),
    "walkway": (WalkwaySettings, simulate_walkway),
    "road": (RoadSettings, simulate_road),
}


def main(argv: list[str]) -> int:
    parser = part_parser(__name__, __doc__)
    parser.add_argument("scene", choices=SCENES)
    parser.add_argument(
        "--events",
        type=Path,
        required=True,
        metavar="E.jsonl",
        help="file for the events, one a line",
    )
    parser.add_argument("--truth", type=Path, metavar="T.json", help="file for the ground truth")
    parser.add_argument("--cameras", type=int, default=argparse.SUPPRESS)
    parser.add_argument(
        "--seconds", type=float, default=argparse.SUPPRESS, help="length of the recording"
    )
    parser.add_argument(
        "--seed", type=int, default=argparse.SUPPRESS, help="same seed, same events"
    )
    options = vars(parser.parse_args(argv))
    settings, simulate = SCENES[options.pop("scene")]
    events_file, truth_file = options.pop("events"), options.pop("truth")

    events, truth = simulate(settings(**options))

    events_file.write_bytes(b"".join(to_json(event) + b"\n" for event in events))
    if truth_file:
        truth_file.write_bytes(to_json(truth) + b"\n")
    print(f"{len(events)} events of {len(truth.cameras)} cameras")
    return 0
