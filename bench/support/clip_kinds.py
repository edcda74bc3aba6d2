"""Kinds of clips: means over kinds, and constants that are chosen on all kinds but one."""

from __future__ import annotations

import importlib
import math
import sys
from collections.abc import Mapping, Sequence
from statistics import mean, stdev
from typing import NamedTuple

PACKAGE = "camtopod.vision"
"""Package whose constants may be chosen."""


class Choice(NamedTuple):
    """A constant of a module of `PACKAGE`, and the values to choose from."""

    module: str
    name: str
    values: list[float]

    def set(self, value: float) -> None:
        """Give the constant a value, in its own module and in those that import it."""
        present = self.present
        for module in [sys.modules[name] for name in sys.modules if name.startswith(PACKAGE)]:
            if getattr(module, self.name, None) is present:
                setattr(module, self.name, value)

    @property
    def present(self) -> float:
        """The value that the constant has."""
        value: float = getattr(importlib.import_module(f"{PACKAGE}.{self.module}"), self.name)
        return value


def choice_of(text: str) -> Choice:
    """Return the choice of ``detect.blobs:DENSE_SHARE=0.3,0.5``; raise ValueError."""
    place, values = text.split("=")
    module, name = place.split(":")
    present = getattr(importlib.import_module(f"{PACKAGE}.{module}"), name, None)
    if not isinstance(present, int | float):
        raise ValueError(f"{PACKAGE}.{module} has no number {name}")
    return Choice(module, name, [type(present)(value) for value in values.split(",")])


def by_kind(f1: Mapping[str, Sequence[float]]) -> str:
    """Return the line of means.

    f1: F1 of each clip with events, by kind.
    """
    means = {kind: mean(values) for kind, values in f1.items()}
    kinds = ", ".join(f"{kind} {value:.3f}" for kind, value in means.items())
    return f"by kind: {kinds}; {_mean_and_error(list(means.values()))}"


def leave_out_kinds(f1: Mapping[float, Mapping[str, float]], present: float) -> list[str]:
    """Return the lines of a choice: for each kind the value that is best on the others.

    f1: mean F1 by value and kind. The last line compares with the ``present`` value, one of them.
    """
    lines, scores, gains = [], [], []
    for kind in next(iter(f1.values())):
        best = max(
            f1,
            key=lambda value: mean(
                f1[value][other_kind] for other_kind in f1[value].keys() - {kind}
            ),
        )
        scores.append(f1[best][kind])
        gains.append(f1[best][kind] - f1[present][kind])
        figures = ", ".join(f"{value:g}: {f1[value][kind]:.3f}" for value in f1)
        lines.append(f"{kind:20} best on the others {best:g}, here {scores[-1]:.3f} ({figures})")
    return [
        *lines,
        f"chosen on the others: {_mean_and_error(scores)}",
        f"better than {present:g} by: {_mean_and_error(gains)}",
    ]


def _mean_and_error(values: Sequence[float]) -> str:
    error = stdev(values) / math.sqrt(len(values)) if len(values) > 1 else math.inf
    return f"mean over {len(values)} kinds {mean(values):.3f}, standard error {error:.3f}"
