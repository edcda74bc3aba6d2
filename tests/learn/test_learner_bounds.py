"""No step of the learner takes more than a gigabyte or a minute, whatever the valid events.

Each crowd is learned in a process of its own, which reports its time and memory. An eighth of some
runs with the other tests; the whole is behind the marker ``campaign``.
"""

from __future__ import annotations

import json
import random
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest
from paths import ROOT, SUPPORT

from camtopod.learn.learner import Learner
from camtopod.records import Event

T0 = 1_700_000_000.0
MEGABYTES_MAX, STEP_SECONDS_MAX = 1024.0, 60.0
QUICK_SCALE = 0.125


def passages(
    cameras: int,
    count: int,
    apart: float,
    tracked: bool = True,
    placed: bool = True,
    zones: int = 0,
) -> Iterator[Event]:
    """Return alternating entries and exits in each of some cameras, ``apart`` seconds.

    They are at random places or in few ``zones``.
    """
    chance = random.Random(1)
    for number in range(count):
        for camera in range(cameras):
            kind = "exit" if number % 2 else "entry"
            x = chance.random() if not zones else (chance.randrange(zones) + 0.5) / zones
            place = (x, chance.random() if not zones else 0.5) if placed else (None, None)
            track = str(number // 2) if tracked else None
            yield Event(f"c{camera}", kind, T0 + apart * number, *place, track=track)  # type: ignore[arg-type]


def beside_others(cameras: int, count: int, apart: float) -> Iterator[Event]:
    """Return the same, after half an hour of people who walk past twelve other cameras."""
    chance, walks = random.Random(2), []
    for person in range(400):
        t, camera = T0 - 1800.0 + 4.5 * person, chance.randrange(12)
        for _ in range(3):
            for kind, x, stay in (("entry", 0.1, 5.0), ("exit", 0.9, 0.0)):
                walks.append(Event(f"good{camera}", kind, t, x, 0.5, track=str(person)))  # type: ignore[arg-type]
                t += stay + chance.random()
            t, camera = t + chance.gauss(9.0, 1.0), (camera + 1) % 12
    yield from sorted(walks, key=lambda event: event.t)
    yield from passages(cameras, count, apart)


CROWDS: dict[str, Callable[[float], Iterator[Event]]] = {
    "one camera": lambda scale: passages(1, int(20_000 * scale), 1 / 200),
    "three cameras": lambda scale: passages(3, int(9_000 * scale), 1 / 200),
    "three cameras beside twelve": lambda scale: beside_others(3, int(11_400 * scale), 1 / 190),
    "a microsecond apart": lambda scale: passages(3, int(10_000 * scale), 1e-6),
    "twenty cameras": lambda scale: passages(20, int(3_000 * scale), 1 / 200),
    "a hundred at one instant": lambda scale: passages(100, int(400 * scale), 0.0),
    "no tracks": lambda scale: passages(1, int(20_000 * scale), 1 / 200, tracked=False),
    "no positions": lambda scale: passages(3, int(9_000 * scale), 1 / 200, placed=False),
    "few zones": lambda scale: passages(3, int(9_000 * scale), 1 / 200, zones=3),
    "a full window": lambda scale: passages(2, int(30_000 * scale), 1 / 45),
    "many full windows": lambda scale: passages(50, int(2_000 * scale), 1 / 5, zones=4),
}


def main(name: str, scale: float) -> None:
    """Learn a crowd; print the longest step (processor seconds) and the peak memory."""
    learner, longest, versions = Learner(), 0.0, 0
    steps: list[Callable[[], object]] = [
        *(lambda event=event: learner.receive(event) for event in CROWDS[name](scale)),
        learner.flush,  # type: ignore[misc]
    ]
    for step in steps:
        began = time.process_time()
        step()
        longest = max(longest, time.process_time() - began)
        versions += len(learner.updates())
    print(json.dumps({"seconds": longest, "megabytes": most_megabytes(), "versions": versions}))


def most_megabytes() -> float:
    """Return the peak memory of this process, megabytes.

    `resource.getrusage` would begin with that of the parent process.
    """
    return int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0]) / 1024


def took(name: str, scale: float) -> dict[str, float]:
    found = subprocess.run(
        [sys.executable, __file__, name, str(scale)],
        capture_output=True,
        check=True,
        cwd=ROOT,
        env={"PYTHONPATH": f"{ROOT}:{SUPPORT}", "OMP_NUM_THREADS": "1"},
    )
    return msgspec.json.decode(found.stdout, type=dict[str, float])


@pytest.mark.parametrize("name", ["a microsecond apart", "a hundred at one instant"])
def test_an_eighth_of_a_crowd(name: str) -> None:
    found = took(name, QUICK_SCALE)
    assert found["versions"] > 0
    assert found["megabytes"] < MEGABYTES_MAX / 2
    assert found["seconds"] < STEP_SECONDS_MAX / 2


@pytest.mark.campaign
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", CROWDS)
def test_a_whole_crowd(name: str) -> None:
    found = took(name, 1.0)
    print(
        f"{name}: {found['megabytes']:.0f} MB, a step {found['seconds']:.1f} s, {found['versions']:.0f} versions"
    )
    assert found["versions"] > 0
    assert found["megabytes"] < MEGABYTES_MAX
    assert found["seconds"] < STEP_SECONDS_MAX


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
