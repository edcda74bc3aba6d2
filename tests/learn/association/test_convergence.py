"""A run of EM ends when it has converged, or after its number of iterations."""

from __future__ import annotations

import numpy as np
import pytest

from camtopod.learn.association import ConvergenceMonitor


def test_a_run_ends_once_an_iteration_moves_hardly_any_transitions() -> None:
    monitor = ConvergenceMonitor(iterations_max=10)
    for iteration in monitor:
        monitor.report(np.array([5.0 + 0.1**iteration, 5.0 - 0.1**iteration]))
    assert monitor.history == pytest.approx([0.18, 0.018, 0.0018, 0.00018])
    assert monitor.converged


def test_a_run_that_does_not_converge_ends_and_says_so() -> None:
    monitor = ConvergenceMonitor(iterations_max=4)
    for iteration in monitor:
        monitor.report(np.array([1.0, iteration % 2]))
    assert len(monitor.history) == 3
    assert not monitor.converged


def test_no_transitions_at_all_have_converged() -> None:
    monitor = ConvergenceMonitor()
    for _ in monitor:
        monitor.report(np.zeros(0))
    assert monitor.converged
