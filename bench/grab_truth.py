"""Score the grabber's events on two real clips against passages annotated by hand.

    python -m bench grab_truth [--data FOLDER] [--vtest FILE] [--rtsp] [--details]

FOLDER holds one-by-one/ (default: the environment's CAMTOPOD_TEST_DATA). ``--rtsp`` also serves
vtest.avi over a real RTSP server in real time (two minutes) and compares with the file. Tolerances:
1.5 s and 0.12 of the diagonal.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

import numpy as np

from bench.support import rtsp_streams as streams
from bench.support.watched_clips import (
    VTEST,
    Match,
    best_offset,
    match,
    one_by_one,
    shifted,
    watched,
)
from camtopod.records import Event
from camtopod.vision.grabber import Grabber

VTEST_FPS = 7.0
"""Frame rate at which vtest.avi was recorded."""


def main(argv: list[str]) -> int:
    """Print the figures and return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m bench grab_truth")
    parser.add_argument("--data", help="folder with one-by-one/")
    parser.add_argument(
        "--vtest", type=Path, default=VTEST, help="vtest.avi of Debian's opencv-doc"
    )
    parser.add_argument("--rtsp", action="store_true", help="also over a real RTSP server")
    parser.add_argument("--details", action="store_true", help="list missed and spurious events")
    arguments = parser.parse_args(argv)
    if arguments.data:
        os.environ["CAMTOPOD_TEST_DATA"] = arguments.data

    # First clip.
    clip = one_by_one()
    if clip is None:
        print("one-by-one: skipped, clip not found (set --data or CAMTOPOD_TEST_DATA)")
    else:
        _file("one-by-one", clip, watched("one_by_one", 10.0), 768 / 432, arguments.details)

    # Second clip, at the header's and at its true frame rate.
    if not arguments.vtest.exists():
        print(f"vtest: skipped, no {arguments.vtest} (install Debian's opencv-doc)")
        return 0
    with tempfile.TemporaryDirectory() as folder:
        slow = Path(folder) / "vtest.mp4"
        if reason := streams.missing():
            print(f"vtest at its true 7 frames/s and over RTSP: {reason}")
            _file(
                "vtest (10 frames/s, as in the file)",
                arguments.vtest,
                watched("vtest", 10.0),
                4 / 3,
                True,
            )
            return 0
        streams.transcode(arguments.vtest, slow, VTEST_FPS)
        _file(
            "vtest, avi (plays at 10 fps)",
            arguments.vtest,
            watched("vtest", 10.0),
            4 / 3,
            arguments.details,
        )
        recorded = _file(
            "vtest, mp4 (7 fps)", slow, watched("vtest", VTEST_FPS), 4 / 3, arguments.details
        )
        if arguments.rtsp:
            _rtsp(slow, recorded, arguments.details)
    return 0


def _file(name: str, path: Path, truth: list[Event], aspect: float, details: bool) -> list[Event]:
    """Run the grabber on a file, print its score and return its events."""
    grabber = Grabber("cam", str(path), wall_clock=time.time)
    began = time.process_time()
    events = [event for event in grabber.events() if event is not None]
    seconds = time.process_time() - began
    figures = grabber.statistics()
    _line(name, truth, events, match(truth, events, aspect), details)
    print(
        f"    {1e3 * figures['analysis_cpu_seconds'] / figures['frames_analysed']:.2f} ms of "
        f"CPU a frame for analysing {figures['frames_analysed']} of "
        f"{figures['frames_grabbed']} frames; {seconds:.1f} s with decoding"
    )
    return events


def _line(name: str, truth: list[Event], events: list[Event], result: Match, details: bool) -> None:
    """Print what was found, missed and spurious."""
    for kind in ("entry", "exit"):
        found = sum(truth[i].kind == kind for i, _ in result.pairs)
        missed = sum(truth[i].kind == kind for i in result.missed)
        spurious = sum(events[j].kind == kind for j in result.spurious)
        print(f"{name}: {kind} found {found} missed {missed} spurious {spurious}")
    print(f"{name}: F1 {result.f1:.3f}")
    if details:
        for label, some in (
            ("missed", [truth[i] for i in result.missed]),
            ("spurious", [events[j] for j in result.spurious]),
        ):
            for event in some:
                print(f"    {label} {event.kind} at {event.t:.1f} s ({event.x:.2f}, {event.y:.2f})")


def _rtsp(path: Path, recorded: list[Event], details: bool) -> None:
    """Serve ``path`` once over RTSP and compare the events with those of the file itself."""
    streamed = []
    with streams.served(path) as port:
        grabber = Grabber("cam", f"rtsp://127.0.0.1:{port}/camera", wall_clock=time.time)
        for event in grabber.events():
            if event is not None:
                streamed.append(event)
            if grabber.statistics()["failures"]:
                break
        grabber.close()

    # Subtract the clock difference before comparing.
    offset = best_offset(recorded, streamed, 4 / 3)
    streamed = shifted(streamed, offset)
    result = match(recorded, streamed, 4 / 3)
    _line("vtest, RTSP against the file", recorded, streamed, result, details)
    differences = [streamed[j].t - recorded[i].t for i, j in result.pairs]
    if differences:
        print(
            f"    times differ by {np.std(differences):.3f} s (sd), "
            f"{np.abs(differences).max():.3f} s at most"
        )


if __name__ == "__main__":
    import sys

    sys.exit(main(sys.argv[1:]))
