"""Events -> topology -> prediction. Deterministic: no I/O, no clock, no threads, no hidden
randomness.

In the order in which data flows:

* `learner`: the whole; `settings`: its limits
* `intake`: any order in, by time out; `window`: the events that count, as sums that can be undone; `positions`
* `daspec` and `clutter`, `partition`, `evidence`, `valley`: entry and exit zones; `mixture`: which cell is which zone;
  `zones`: all of it, with numbers that stay with their place; `moved`: a camera that was turned
* `coarse`, `twoway`, `clocks`: whose clock is wrong, and by how much
* `scene`: who left, who came, who passed through; `rates`: how often anyway; `slowness`: how fast
* `long_ways`: cameras between which it takes minutes
* `candidates`, `lags`, `exposure`, `smoothing`, `joint`: which arrival belongs to which departure; `passages`: also in
  one view
* `crossfit`, `significance`, `missed`: whether that makes a link; `transit`, `montecarlo`, `mahalanobis`: its
  figures; `links`
* `overlap`, `relations`: how cameras hang together; `chain`: the Markov chain over them
* `change`, `silence`, `alarms`: what opened, closed, moved or fell silent; `scoring`: how good its own predictions were
* `posterior`, `entering`, `prior`, `contexts`, `skipped`, `skipping`, `sampling`: where objects go, all weak evidence
  included; `doubt`: what of that may be chance; `model`: what of it a version carries
* `assemble`, `rounding`, `topology`: versions with digests and deltas
* `hazards`, `places`, `surroundings`, `pace`, `recent`, `under_way`, `succession`, `lag_odds`, `ready`, `predict`:
  where to look next, and when
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import names_from

if TYPE_CHECKING:
    from camtopod.learn.assemble import by_clocks
    from camtopod.learn.learner import STEPS, Learner
    from camtopod.learn.prediction_model import OUTCOMES_PER_ZONE_MAX
    from camtopod.learn.rewinding import rewound
    from camtopod.learn.settings import Settings
    from camtopod.learn.snapshot import (
        BYTES_MAX,
        LearnerState,
        NewerSnapshot,
        SnapshotError,
        pack,
        unpack,
    )

__all__ = [
    "BYTES_MAX",
    "OUTCOMES_PER_ZONE_MAX",
    "STEPS",
    "Learner",
    "LearnerState",
    "NewerSnapshot",
    "Settings",
    "SnapshotError",
    "by_clocks",
    "pack",
    "rewound",
    "unpack",
]

__getattr__ = names_from(
    __name__,
    {
        "BYTES_MAX": "snapshot",
        "Learner": "learner",
        "LearnerState": "snapshot",
        "NewerSnapshot": "snapshot",
        "OUTCOMES_PER_ZONE_MAX": "prediction_model",
        "STEPS": "learner",
        "Settings": "settings",
        "SnapshotError": "snapshot",
        "by_clocks": "assemble",
        "pack": "snapshot",
        "rewound": "rewinding",
        "unpack": "snapshot",
    },
)
