"""The learner in its own process, so that refits do not delay receiving and predicting.

Read `messages` first, the protocol between the daemon and the process. `feeder` and `process` are
the daemon's side, `worker` is the process. `recovery` loads the learner from the journal at the
start.
"""

from camtopod.serve.learner_process.feeder import LearnerFeeder as LearnerFeeder
from camtopod.serve.learner_process.messages import (
    LearnProgress as LearnProgress,
    NewVersion as NewVersion,
)
from camtopod.serve.learner_process.process import (
    LearnerEnded as LearnerEnded,
    LearnerProcess as LearnerProcess,
)
from camtopod.serve.learner_process.recovery import (
    Recovered as Recovered,
    event_time as event_time,
    newest_topology as newest_topology,
    note_failure as note_failure,
    recent_events as recent_events,
    recover as recover,
)
