"""What the parts of the bench share: options, folders of recordings, and files of results.

A real network is a folder in ``--data`` (default: CAMTOPOD_REAL_DATA) with events.jsonl and
identities.csv.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Collection
from pathlib import Path
from typing import TypeVar

from msgspec import to_builtins

from bench.support.jobs import map_tasks

_Result = TypeVar("_Result")


def part_parser(module: str, docstring: str | None) -> argparse.ArgumentParser:
    """Return a parser of a part of the bench, whose help is the docstring of its module."""
    title, *text = (docstring or "").split("\n\n", 2)
    return argparse.ArgumentParser(
        prog=f"python -m {module.replace('.', ' ')}",
        description=title,
        epilog="".join(text[1:]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def data_parser(module: str, docstring: str | None) -> argparse.ArgumentParser:
    """Return a parser with ``--data`` and ``--jobs``, of a part of the bench."""
    parser = part_parser(module, docstring)
    folder = os.environ.get("CAMTOPOD_REAL_DATA")
    parser.add_argument(
        "--data", type=Path, default=Path(folder) if folder else None, metavar="FOLDER"
    )
    parser.add_argument("--jobs", type=int, default=2, help="processes (default 2)")
    return parser


def networks_parser(module: str, docstring: str | None) -> argparse.ArgumentParser:
    """Return a parser of a part that measures real networks; `results_of` takes its arguments."""
    parser = data_parser(module, docstring)
    parser.set_defaults(part=module.replace(".", " "))
    parser.add_argument("--networks", help="comma-separated (default: all)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results")
    return parser


def names_from(names: Collection[str]) -> Callable[[str], list[str]]:
    """Return the type of an option whose value is one or several of ``names``, comma-separated."""

    def names_in(text: str) -> list[str]:
        chosen_names = [name for name in text.split(",") if name]
        unknown = [name for name in chosen_names if name not in names]
        if unknown:
            raise argparse.ArgumentTypeError(
                f"no {', '.join(unknown)}; choose from {', '.join(names)}"
            )
        return chosen_names

    return names_in


def folders_in(data: Path | None) -> list[Path]:
    """Return the folders of all networks, by name; none without data."""
    return sorted(path.parent for path in data.glob("*/identities.csv")) if data else []


def results_of(arguments: argparse.Namespace, measure: Callable[[Path], _Result]) -> list[_Result]:
    """Return what ``measure`` returns for each chosen network, and write it to ``--json``.

    Without any network it says that the part is skipped.
    """
    folders = folders_in(arguments.data)
    if arguments.networks:
        names = arguments.networks.split(",")
        folders = [folder for folder in folders if folder.name in names]
    if not folders:
        print(f"{arguments.part}: skipped, no recordings found (set --data or CAMTOPOD_REAL_DATA)")
    results = map_tasks(measure, folders, arguments.jobs)
    if results:
        write_json(arguments.json, to_builtins(results, str_keys=True))
    return results


def write_json(path: Path | None, content: object) -> None:
    """Write results to a file, if one is named."""
    if path is not None:
        path.write_text(json.dumps(content, indent=1) + "\n")
