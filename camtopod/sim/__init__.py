"""Simulated camera networks with ground truth: events for `camtopod simulate`, videos for the demo.

`simulation.simulate` makes events; it uses, in this order, `settings` (what can be simulated),
`layout` (zones and paths), `faults` (clock offsets, closing doors, turned cameras), `walkers`
(passages of people) and `reports` (events and ground truth). The demo uses `floor` (floor plan and
walks), `render` (videos) and `picture` (the map it shows). `truth` defines the ground truth,
`score` and `calibration` compare a topology and predictions with it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import lazy_getattr

if TYPE_CHECKING:
    from camtopod.sim.floor import Plan, Walk, demo_plan, passages, simulate_walks, truth_of
    from camtopod.sim.picture import write_map
    from camtopod.sim.rendering import SUFFIX, render
    from camtopod.sim.scoring import score
    from camtopod.sim.simulation import SimSettings, simulate
    from camtopod.sim.truth import Truth

__all__ = [
    "SUFFIX",
    "Plan",
    "SimSettings",
    "Truth",
    "Walk",
    "demo_plan",
    "passages",
    "render",
    "score",
    "simulate",
    "simulate_walks",
    "truth_of",
    "write_map",
]

__getattr__ = lazy_getattr(
    __name__,
    {
        "Plan": "floor",
        "SUFFIX": "rendering",
        "SimSettings": "simulation",
        "Truth": "truth",
        "Walk": "floor",
        "passages": "floor",
        "render": "rendering",
        "score": "scoring",
        "simulate": "simulation",
        "demo_plan": "floor",
        "simulate_walks": "floor",
        "truth_of": "floor",
        "write_map": "picture",
    },
)
