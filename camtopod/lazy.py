"""Package doors that load a module when one of its names is first asked for (PEP 562).

For packages of which most users want a light part: settings are read without SciPy, a bus is spoken
without OpenCV.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module


def names_from(package: str, homes: Mapping[str, str]) -> Callable[[str], object]:
    """Return a package's ``__getattr__``.

    package (dotted name): the package whose door it is.
    homes: the module below the package that holds each public name.
    """

    def get(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{homes[name]}"), name)

    return get
