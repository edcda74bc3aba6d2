"""Run one part of the bench: ``python -m bench PART [ARGUMENTS]``.

Each part is a module of this package with ``main(argv) -> int``.
"""

from __future__ import annotations

import ast
import sys
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

import bench


def main(argv: list[str]) -> int:
    parts = sorted(
        module.name
        for module in iter_modules(bench.__path__)
        if not module.ispkg and not module.name.startswith("_")
    )
    if not argv or argv[0] not in parts:
        print("usage: python -m bench PART [ARGUMENTS]; PART is one of", file=sys.stderr)
        for name in parts:
            docstring = ast.get_docstring(
                ast.parse(Path(bench.__path__[0], f"{name}.py").read_text())
            )
            print(f"  {name:<11} {(docstring or '').splitlines()[0]}", file=sys.stderr)
        return 2
    try:
        status: int = import_module(f"bench.{argv[0]}").main(argv[1:])
    except ModuleNotFoundError as error:
        package = (error.name or "bench").partition(".")[0]
        if package in ("bench", "camtopod"):
            raise
        sentence = f"bench {argv[0]} needs {package}: pip install -e '.[test,bench]'"
        print(sentence, file=sys.stderr)
        return 1
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
