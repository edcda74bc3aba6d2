"""A learner process of a later release, with another snapshot format.

It replaces `camtopod.serve.learner_process.worker`.
"""

from __future__ import annotations

from typing import Any

from camtopod.learn import snapshot
from camtopod.serve.learner_process import worker


def main(*given: Any) -> None:
    snapshot.FORMAT += 1
    worker.main(*given)
