"""Lazy package heads: a module is imported when one of its names is first used (PEP 562).

For packages of which most users need a light part: reading settings does not import SciPy, and
using the bus does not import OpenCV.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module


def lazy_getattr(package: str, homes: Mapping[str, str]) -> Callable[[str], object]:
    """Return the ``__getattr__`` of a package that imports its modules lazily.

    package: dotted name of the package.
    homes: for each public name, the module below the package that defines it.
    """

    def get(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{homes[name]}"), name)

    return get
