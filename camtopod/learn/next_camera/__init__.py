"""The posterior for prediction: in which zone objects appear next, weak evidence included.

A published link must be significant; a prediction uses all evidence according to its weight. In the
order to read:

* `fit`: the fit, an extension of the joint fit (`association`) by the terms below
* `prior`: pairs of zones borrow strength from the rest of the view and from the way back
* `overlapping_views` and `entry_kernels`: appearances in the next view before the exit
* `skipped_cameras` and `skip_rate`: appearances after a camera that missed the passage
* `contexts`: the zone of entry, the place of exit and the previous camera of a departure
* `sampling`: Monte Carlo over the sources of arrivals, against overconfidence
* `spurious`: the share of each pair's transitions that may be made by chance
"""

from __future__ import annotations

from camtopod.learn.next_camera.contexts import LEVELS
from camtopod.learn.next_camera.fit import Posterior, fit_followed, followed_of
from camtopod.learn.next_camera.overlapping_views import (
    OverlappingViews,
    find_overlapping,
    overlap_table,
    views_of,
)

__all__ = [
    "LEVELS",
    "OverlappingViews",
    "Posterior",
    "find_overlapping",
    "fit_followed",
    "followed_of",
    "overlap_table",
    "views_of",
]
