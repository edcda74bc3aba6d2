"""The posterior for prediction: in which zone objects appear next, weak evidence included.

A published link must be significant; a prediction uses all evidence according to its weight. The
result is a `Posterior`: for every pair of zones, the share of the departures at the first zone that
appear next at the second, and the hazard (rate of appearing by lag). In the order to read:

* `fit`: the fit for prediction, which extends the joint fit (`association`) by what follows
* `prior`: where data are few, pairs of zones get transitions from return traffic
* `overlapping_views` and `entry_kernels`: objects that appear in the next view before they leave
  this one
* `contexts`: the zone of entry, the place of exit and the previous camera of a departure
* `spurious`: the share of each pair's transitions that may be made by chance
"""

from camtopod.learn.next_camera.contexts import LEVELS as LEVELS
from camtopod.learn.next_camera.fit import (
    Posterior as Posterior,
    fit_window as fit_window,
    with_doubt as with_doubt,
)
from camtopod.learn.next_camera.overlapping_views import (
    OverlappingViews as OverlappingViews,
    find_overlapping as find_overlapping,
    overlap_table as overlap_table,
)
