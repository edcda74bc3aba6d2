"""Run a function over many tasks, in several processes or in this one."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")


def map_tasks(work: Callable[[_Task], _Result], tasks: Sequence[_Task], jobs: int) -> list[_Result]:
    """Return ``work(task)`` for each task, in order, computed by ``jobs`` processes.

    Processes are spawned: one forked from a process with threads may deadlock.
    """
    if jobs <= 1:
        return list(map(work, tasks))
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(work, tasks))
