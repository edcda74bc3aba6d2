"""Run a function over many tasks, in several processes or in this one."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import TypeVar

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")


def map_tasks(work: Callable[[_Task], _Result], tasks: Sequence[_Task], jobs: int) -> list[_Result]:
    """Return ``work(task)`` for each task, in order, computed by ``jobs`` processes."""
    if jobs <= 1:
        return list(map(work, tasks))
    with _processes(jobs) as pool:
        return list(pool.map(work, tasks))


def completed_tasks(
    work: Callable[[_Task], _Result], tasks: Sequence[_Task], jobs: int
) -> Iterator[_Result]:
    """Yield ``work(task)`` for each task as soon as it is computed, by ``jobs`` processes."""
    if jobs <= 1:
        yield from map(work, tasks)
        return
    with _processes(jobs) as pool:
        for future in as_completed([pool.submit(work, task) for task in tasks]):
            yield future.result()


def _processes(jobs: int) -> ProcessPoolExecutor:
    """Return a pool of processes with one thread each for linear algebra.

    Processes are spawned: one forked from a process with threads may deadlock.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # inherited by the processes
    return ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn"))
