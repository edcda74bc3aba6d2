"""A learner process that returns the first two versions of epoch E together.

It replaces `camtopod.serve.learner_process.worker`.
"""

from __future__ import annotations

from typing import Any

from camtopod.learn.learner import Learner
from camtopod.records import Topology
from camtopod.serve.learner_process import worker


class HoardingLearner(Learner):
    """A learner that seems to have made both versions in one step."""

    def updates(self) -> list[Topology]:
        return [] if len(self._updates) == 1 and self.epoch == "E" else super().updates()


def main(*given: Any) -> None:
    worker.main(*given, learner=HoardingLearner)
