"""In place of `camtopod.serve.learner_process.worker`: the same of a later release, with another
format of the snapshot.
"""

from __future__ import annotations

from camtopod.learn import snapshot
from camtopod.serve.learner_process.worker import main

if __name__ == "__main__":
    snapshot.FORMAT += 1
    main()
