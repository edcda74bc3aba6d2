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


def _refuse(one: object, name: str) -> object:
    """Get an attribute of a parent's object: closing it does nothing, all else raises."""
    if name == "close":
        return lambda: None
    if name.startswith("__"):
        return object.__getattribute__(one, name)
    raise BusError(FORKED)


_guarded: weakref.WeakSet[Any] = weakref.WeakSet()
_used: list[bool] = []  # not empty once this process has opened a session, or tried to
_forked: list[bool] = []  # not empty in a child of such a process


def guard(one: Any) -> None:
    """Make ``one``, which can be closed, unusable in children that are forked from now on."""
    _guarded.add(one)


def note_use() -> None:
    """Note that zenoh's threads begin here. Raises `BusError` if a parent has had them."""
    if _forked:
        raise BusError(FORKED)
    _used.append(True)


def _after_fork() -> None:
    """Take the parent's objects from a child."""
    _forked.extend(_used[:1])
    for one in list(_guarded):
        atexit.unregister(one.close)
        kind: Any = type(one)
        one.__class__ = type(kind)(kind.__name__, (kind,), {"__getattribute__": _refuse})


os.register_at_fork(after_in_child=_after_fork)
