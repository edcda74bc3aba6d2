"""The examples for trackers with the real packages: from a film to correct event lines."""

from __future__ import annotations

import importlib.metadata
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import cv2
import pytest
from paths import EXAMPLES
from rendered_scenes import HEIGHT, WIDTH, Person, Scene, line

from camtopod.codec import event_from_json
from camtopod.records import Event

SCALE = 2
FPS = 10.0
LONGEST_LINES = 10
"""What a tracker needs to plug in, without imports; a line of comment counts, an empty one does
not.
"""


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a film of 24 seconds with two people on two paths, one some time after the other."""
    there, back = line(3, (-0.1, 0.5), (1.1, 0.5), 9), line(9, (1.1, 0.9), (-0.1, 0.9), 9)
    scene = Scene([Person(there, shade=30, tall=0.3), Person(back, shade=220, tall=0.3, seed=1)])
    path = tmp_path_factory.mktemp("film") / "film.avi"
    size = (SCALE * WIDTH, SCALE * HEIGHT)
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), FPS, size)
    for number in range(240):
        picture = cv2.resize(scene.picture(number / FPS), size)
        video.write(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    video.release()
    return path


@pytest.mark.parametrize("package", ["supervision", "norfair"])
def test_the_example_sees_who_comes_and_goes(package: str, film: Path) -> None:
    reason = f"needs {package}, see tests/examples/README.md"
    pytest.importorskip(package, reason=reason, exc_type=ImportError)
    command = [sys.executable, str(EXAMPLES / f"with_{package}.py"), str(film)]

    done = subprocess.run(command, capture_output=True, timeout=100, check=True)

    events = [event_from_json(text) for text in done.stdout.splitlines()]
    assert_near(events, "entry", [(3.75, 0.0, 0.5), (9.75, 1.0, 0.9)])
    assert_near(events, "exit", [(11.25, 1.0, 0.5), (17.25, 0.0, 0.9)])
    kinds = defaultdict(list)
    for event in events:
        kinds[event.track].append(event.kind)
    assert all(passage == ["entry", "exit"] for passage in kinds.values())


def assert_near(events: list[Event], kind: str, truth: list[tuple[float, float, float]]) -> None:
    """Check times and positions within a second, which trackers need to confirm a track."""
    seen = sorted((e.t, e.x or 0.0, e.y or 0.0) for e in events if e.kind == kind)
    for (t, x, y), (at, true_x, true_y) in zip(seen, truth, strict=True):
        assert abs(t - at) <= 1.0
        assert abs(x - true_x) <= 0.14
        assert abs(y - true_y) <= 0.1  # of somebody half in view the feet need not be found


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("with_*.py")), ids=lambda path: path.stem)
def test_a_tracker_plugs_in_within_ten_lines(path: Path) -> None:
    text = path.read_text()
    compile(text, path, "exec")

    lines = [row for row in text[text.index("video = ") :].splitlines() if row.strip()]
    assert len(lines) <= LONGEST_LINES


def test_there_is_one_opencv() -> None:
    """Tracker packages tend to bring another OpenCV, which would hide ours."""
    names = {(found.metadata["Name"] or "").lower() for found in importlib.metadata.distributions()}
    assert {name for name in names if name.startswith("opencv")} == {"opencv-python-headless"}
