"""A simulated recording of a small city of three districts."""

from __future__ import annotations

from camtopod.config import with_borders
from camtopod.sim.simulation import SimSettings, simulate

EVENTS, TRUTH = simulate(SimSettings(cameras=9, hours=0.25, seed=4))
CAMERAS = sorted({event.camera for event in EVENTS})
OWNERS = {camera: f"d{number // 3}" for number, camera in enumerate(CAMERAS)}
DISTRICTS = with_borders(OWNERS, [pair.cameras for pair in TRUTH.pairs])
