"""Pauses in what takes long, for whoever makes them: here there is no clock to say when it is time
for one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

Pause = Callable[[], None]
"""Called often while something is made; may take its time."""
_T = TypeVar("_T")


def no_pause() -> None:
    """At once."""


def unhurried(items: Iterable[_T], pause: Pause) -> Iterator[_T]:
    """The same, with ``pause`` called before each."""
    for one in items:
        pause()
        yield one
