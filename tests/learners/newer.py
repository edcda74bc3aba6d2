"""A learner process of a later release, with another snapshot format.

It replaces `camtopod.serve.learner_process.worker`.
"""

from __future__ import annotations

from camtopod.learn import snapshot
from camtopod.serve.learner_process.worker import main

if __name__ == "__main__":
    snapshot.FORMAT += 1
    main()
