"""Made-up camera networks with known truth: events for `simulate`, pixels for `demo`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import names_from

if TYPE_CHECKING:
    from camtopod.sim.floor import Plan, Walk, passages, site, stroll, truth_of
    from camtopod.sim.picture import Times, camera_times, write_map
    from camtopod.sim.render import SUFFIX, render
    from camtopod.sim.score import score
    from camtopod.sim.simulation import SimSettings, simulate
    from camtopod.sim.truth import Truth

__all__ = [
    "SUFFIX",
    "Plan",
    "SimSettings",
    "Times",
    "Truth",
    "Walk",
    "camera_times",
    "passages",
    "render",
    "score",
    "simulate",
    "site",
    "stroll",
    "truth_of",
    "write_map",
]

__getattr__ = names_from(
    __name__,
    {
        "Plan": "floor",
        "SUFFIX": "render",
        "SimSettings": "simulation",
        "Times": "picture",
        "Truth": "truth",
        "Walk": "floor",
        "camera_times": "picture",
        "passages": "floor",
        "render": "render",
        "score": "score",
        "simulate": "simulation",
        "site": "floor",
        "stroll": "floor",
        "truth_of": "floor",
        "write_map": "picture",
    },
)
