"""Changes of the site within the window, and the alarms that report them.

Reading order: `change_points` finds links that opened, closed or changed their share of the
departures. `silence` finds cameras that report nothing for too long. `camera_moved` finds cameras
that were turned. `repeats` finds recordings that are played in a loop. `alarms` reports each of
these changes once, in the first version that shows it.
"""

from camtopod.learn.changes.alarms import (
    AlarmLog as AlarmLog,
    AlarmState as AlarmState,
    News as News,
)
from camtopod.learn.changes.camera_moved import (
    BEFORE_MIN as BEFORE_MIN,
    Move as Move,
    find_moves as find_moves,
)
from camtopod.learn.changes.change_points import (
    ChangePoint as ChangePoint,
    find_changes as find_changes,
    present as present,
)
from camtopod.learn.changes.repeats import find_repeats as find_repeats
from camtopod.learn.changes.silence import (
    CameraSilences as CameraSilences,
    find_silences as find_silences,
    silent_odds as silent_odds,
)
