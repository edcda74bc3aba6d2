"""The path of events from the bus into the journal.

Start with `intake`, which has the whole path, from the `inbox` (with `received` messages) to the
`store_queue`. `numbers` knows which events of a camera were taken and stored, `cameras` which
cameras there are, `backlogs` for which of them the learner waits, `names` knows forgotten and
renamed cameras, `event_clock` compares event time with this machine's clock, and `answers` ends the
grabbers' requests. `commands` executes an operator's commands.
"""

from camtopod.serve.ingest.backlogs import Backlogs as Backlogs
from camtopod.serve.ingest.cameras import Cameras as Cameras
from camtopod.serve.ingest.commands import execute as execute
from camtopod.serve.ingest.event_clock import EventClock as EventClock
from camtopod.serve.ingest.intake import Intake as Intake
from camtopod.serve.ingest.names import (
    CommandRefused as CommandRefused,
    Names as Names,
    present_names as present_names,
    read_names as read_names,
)
from camtopod.serve.ingest.numbers import Numbers as Numbers
from camtopod.serve.ingest.received import Received as Received
