"""What `bench.version` runs in each of two checkouts: learn a version, or decode and prepare it.

    versions.py learn FOLDER CAMERAS HOURS      writes topology.json, and each message by its key
    versions.py decode FOLDER                   prints processor seconds

It uses what both checkouts have. Only one of them has maps and models.
"""

from __future__ import annotations

import statistics
import sys
import time
from pathlib import Path

from msgspec.structs import replace

from camtopod import codec, predict, records, topology
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.predict.predictor import Predictor
from camtopod.sim.settings import SimSettings
from camtopod.sim.simulation import simulate

ONCE = Settings(refit_share=1e9, refit_hours=1e9)
"""Settings with which no version falls due."""
OBJECTS_PER_SECOND_PER_CAMERA = 0.0123
"""Traffic of the simulated site: about a tenth of an event a second and camera."""
LEARNED_SHARE = 0.9
"""Share of the events after which the first version is made."""
TIMES = 5
"""How often a version is decoded; the median counts."""
HAS_MAPS = hasattr(topology, "map_of")


def learn(folder: Path, cameras: int, hours: float) -> None:
    """Learn a recording, and write the second version."""
    rate = OBJECTS_PER_SECOND_PER_CAMERA * cameras
    events, _ = simulate(
        SimSettings(cameras=cameras, hours=hours, seed=1, objects_per_second=rate, start=0.0)
    )
    learner = Learner(ONCE, "site", "01J")
    first = int(LEARNED_SHARE * len(events))
    for part in (events[:first], events[first:]):
        for event in part:
            learner.receive(event)
        learner.make_version()
    old, new = learner.updates()[-2:]
    messages: dict[str, object] = {
        "topology": topology.map_of(new) if HAS_MAPS else new,
        "topology-delta": topology.make_delta(old, new),
    }
    if HAS_MAPS:
        messages["topology-model"] = topology.version_model(new)
    for name, message in messages.items():
        (folder / name).write_bytes(codec.to_msgpack(message))
    (folder / "topology.json").write_bytes(codec.to_json(new))


def decode(folder: Path) -> float:
    """Return the processor seconds to decode, check and prepare a version, as a client does."""
    messages = [(folder / "topology").read_bytes()]
    if HAS_MAPS:
        messages.append((folder / "topology-model").read_bytes())
    seconds = []
    for _ in range(TIMES):
        start = time.process_time()
        if HAS_MAPS:
            version = codec.read(records.Topology, messages[0], pack=True)
            model = codec.read(records.VersionModel, messages[1], pack=True)
            version = replace(version, model=model.model)
            codec.require_sound(version)
            predict.PreparedVersion(version)
        else:
            Predictor(codec.decode_topology(messages[0], pack=True))
        seconds.append(time.process_time() - start)
    return statistics.median(seconds)


if __name__ == "__main__":
    if sys.argv[1] == "learn":
        learn(Path(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4]))
    else:
        print(decode(Path(sys.argv[2])))
