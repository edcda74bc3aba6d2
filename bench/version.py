"""Measure the bytes of a version, and the time to decode and prepare it, beside another checkout.

    python -m bench version --base FOLDER [--cameras 400] [--hours 1] [--rounds 5] [--json FILE]

Both checkouts learn the same recording of a simulated site, which is not in steady state in its
first minutes. A version is made after nine tenths of it and one at its end; the second is measured:
the file that `camtopod learn` writes, the map, all that the daemon publishes for it, and the
processor time that a client needs from the messages to a version that predicts, checks included.
The versions are kept in the temporary folder, by the source of the checkout. FOLDER is another
checkout, made by ``git worktree add FOLDER COMMIT``.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import bench
from bench.support import ratios
from bench.support.parts import part_parser

HERE, BASE = "this checkout", "base"
TARGETS = {"map": 0.4, "file": 0.5, "bus in all": 0.35, "decode and prepare": 0.2}
"""Largest ratio to the base. The base has no map: its whole topology is taken."""
PROGRAM = Path(__file__).parent / "support" / "versions.py"
"""What both checkouts run."""


def main(argv: Sequence[str]) -> int:
    """Measure, print the tables, write the figures; return the exit status."""
    arguments = _parse(argv)
    checkouts = {BASE: arguments.base.resolve(), HERE: Path(bench.__path__[0]).parent}
    folders = {
        name: learned(checkout, arguments.cameras, arguments.hours)
        for name, checkout in checkouts.items()
    }
    tables = []
    for title, target in TARGETS.items():
        if title != "decode and prepare":
            costs = {name: [size_of(title, folder) / 1e6] for name, folder in folders.items()}
            tables.append(ratios.compare(title, "MB", costs, BASE, {HERE: target}))
    seconds: dict[str, list[float]] = {name: [] for name in checkouts}
    for number in range(arguments.rounds):
        for name in (BASE, HERE) if number % 2 == 0 else (HERE, BASE):
            seconds[name].append(1e3 * float(run(checkouts[name], "decode", folders[name])))
    targets = {HERE: TARGETS["decode and prepare"]}
    tables.append(ratios.compare("decode and prepare", "ms", seconds, BASE, targets))
    print("\n".join(line for table in tables for line in ratios.lines(table)))
    ratios.write(
        arguments.json, "version", tables, cameras=arguments.cameras, hours=arguments.hours
    )
    return 0


def learned(checkout: Path, cameras: int, hours: float) -> Path:
    """Return the folder with the messages and the file of a version that a checkout has learned."""
    source = hashlib.sha256()
    for path in sorted(checkout.glob("camtopod/**/*.py")):
        source.update(path.read_bytes())
    name = f"camtopod-bench-version-{cameras}-{hours:g}-{source.hexdigest()[:16]}"
    folder = Path(tempfile.gettempdir()) / name
    if not (folder / "topology.json").exists():
        folder.mkdir(exist_ok=True)
        run(checkout, "learn", folder, cameras, hours)
    return folder


def size_of(title: str, folder: Path) -> int:
    """Return bytes: of the file, of the map, or of all messages."""
    if title == "file":
        return (folder / "topology.json").stat().st_size
    messages = [folder / "topology"] if title == "map" else folder.glob("topology*")
    return sum(path.stat().st_size for path in messages if path.suffix != ".json")


def run(checkout: Path, *arguments: object) -> str:
    """Run `PROGRAM` with the package of a checkout; return what it prints."""
    command = [sys.executable, str(PROGRAM), *map(str, arguments)]
    environment = os.environ | {"PYTHONPATH": str(checkout)}
    return subprocess.run(
        command, cwd=checkout, env=environment, stdout=subprocess.PIPE, check=True, text=True
    ).stdout


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = part_parser(__name__, __doc__)
    parser.add_argument("--base", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--cameras", type=int, default=400)
    parser.add_argument("--hours", type=float, default=1.0)
    ratios.add_arguments(parser, rounds=5)
    return parser.parse_args(argv)
