"""What a forked child must not use: the bus's threads are in its parent alone.

A call on zenoh would never return there, and events would get numbers that the parent gives again.
So in a child every use of its parent's sessions, and opening one, raises `BusError`.
"""

from __future__ import annotations

import atexit
import os
import weakref
from typing import Any

from camtopod.serve.bus.access import BusError

FORKED = (
    "this process was forked from one that uses the bus, whose threads it does not have: start it"
    ' with multiprocessing.get_context("spawn"), and connect in it'
)
"""Error message in a forked child."""


def _refuse(target: object, name: str) -> object:
    """Get an attribute of a parent's object: closing it does nothing, all else raises."""
    if name == "close":
        return lambda: None
    if name.startswith("__"):
        return object.__getattribute__(target, name)
    raise BusError(FORKED)


_targets: weakref.WeakSet[Any] = weakref.WeakSet()
_uses: list[bool] = []  # not empty once this process has opened a session, or tried to
_forks: list[bool] = []  # not empty in a child of such a process


def guard(target: Any) -> None:
    """Make ``target``, which can be closed, unusable in children that are forked from now on."""
    _targets.add(target)


def note_use() -> None:
    """Note that zenoh's threads begin here. Raises `BusError` if a parent has had them."""
    if _forks:
        raise BusError(FORKED)
    _uses.append(True)


def _after_fork() -> None:
    """Take the parent's objects from a child."""
    _forks.extend(_uses[:1])
    for target in list(_targets):
        atexit.unregister(target.close)
        kind: Any = type(target)
        target.__class__ = type(kind)(kind.__name__, (kind,), {"__getattribute__": _refuse})


os.register_at_fork(after_in_child=_after_fork)
