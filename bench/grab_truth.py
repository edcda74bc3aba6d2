"""Score the grabber's events on real clips against ground truth.

    python -m bench grab_truth [FOLDER...] [--drawn SEEDS] [--variants] [--phases 4] [--details]
                               [--json FILE] [--data FOLDER] [--vtest FILE] [--rtsp]

Each FOLDER holds clips with their truth beside them: NAME.mp4 with NAME.jsonl, a line for each
event, ``{"kind": "entry", "t": 8.25, "x": 0.31, "y": 0.88}`` (seconds from the beginning of the
file, foot point in fractions of the picture); or with NAME.json, passages by frame number as in
bench/support/truth_vtest.json. An empty NAME.jsonl stands for a clip without events. Without a
FOLDER it scores the two clips with which the grabber was developed: one-by-one/ of --data (default:
the environment's CAMTOPOD_TEST_DATA) and Debian's vtest.avi.

An event counts as found within 1.5 s and 0.12 of the picture's diagonal, if it is of the same kind.
``--drawn`` adds drawn scenes of situations that are hard (two who enter together, a highway, a door
in mid-view): for finding errors, not for judging how good the grabber is.

Each clip is analysed several times, at 7 pictures a second, with the first frames left out, as a
single clip's figures vary with the pictures that happen to be taken. ``--variants`` adds what can
be made of the clips: mirrored, backwards in time, cropped where nobody enters or leaves, with half
the light, shaken, slowed, begun later, with a bush in the wind, and two side by side, each with its
truth changed accordingly. ``--rtsp`` also serves vtest.avi over a real RTSP server in real time
(two minutes) and compares with the file.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import mean

import msgspec
import numpy as np
from msgspec import Struct

from bench.scenes.drawn_clips import drawn_clips
from bench.support import rtsp_streams as streams
from bench.support.clip_variants import with_variants
from bench.support.truth_clips import Clip, TruthError, clip_of, clips_in
from bench.support.watched_clips import HERE, VTEST, best_offset, match, one_by_one, shifted
from camtopod.records import Event
from camtopod.vision.grabber import Grabber
from camtopod.vision.pipeline import ViewPipeline

PHASES = 4
"""Times that each clip is analysed, with other pictures of it."""
VTEST_FPS = 7.0
"""Frame rate at which vtest.avi was recorded."""
_NAME = 44
"""Width of the column of names."""


class Run(Struct):
    """One analysis of a clip: numbers of events, and processor seconds with decoding."""

    found: int
    missed: int
    spurious: int
    cpu_seconds: float

    @property
    def precision(self) -> float:
        """Share of the reported events that are true; 1.0 if there are none."""
        reported = self.found + self.spurious
        return self.found / reported if reported else 1.0

    @property
    def recall(self) -> float:
        """Share of the true events that were found; 1.0 if there are none."""
        true = self.found + self.missed
        return self.found / true if true else 1.0

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall; 1.0 if there was nothing to see or seen."""
        total = 2 * self.found + self.missed + self.spurious
        return 2 * self.found / total if total else 1.0


class Score(Struct):
    """All runs of one clip."""

    clip: str
    variant: str
    """Name of the variant; "" for the clip as it is."""
    seconds: float
    """Length of the clip."""
    true_events: int
    runs: list[Run]

    @property
    def f1(self) -> float:
        """Mean over the runs."""
        return mean(run.f1 for run in self.runs)

    @property
    def load(self) -> float:
        """Processor seconds for each second of video, mean over the runs."""
        return mean(run.cpu_seconds for run in self.runs) / self.seconds


def main(argv: list[str]) -> int:
    """Print the table and return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m bench grab_truth",
        description=(__doc__ or "").partition("\n\n")[0],
        epilog=(__doc__ or "").split("\n\n", 2)[2],
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "folders", nargs="*", type=Path, metavar="FOLDER", help="clips with their truth files"
    )
    parser.add_argument("--variants", action="store_true", help="also score variants of the clips")
    parser.add_argument(
        "--phases", type=int, default=PHASES, help="runs a clip (default: %(default)s)"
    )
    parser.add_argument(
        "--drawn",
        type=int,
        default=0,
        metavar="SEEDS",
        help="also score drawn scenes, each from this many seeds",
    )
    parser.add_argument(
        "--details", action="store_true", help="list missed and spurious events of the first run"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures there")
    parser.add_argument("--data", help="folder with one-by-one/")
    parser.add_argument(
        "--vtest", type=Path, default=VTEST, help="vtest.avi of Debian's opencv-doc"
    )
    parser.add_argument(
        "--rtsp", action="store_true", help="also vtest.avi over a real RTSP server"
    )
    arguments = parser.parse_args(argv)
    if arguments.phases < 1:
        parser.error("--phases must be 1 or more")
    if arguments.data:
        os.environ["CAMTOPOD_TEST_DATA"] = arguments.data

    # Score the clips.
    try:
        clips = [clip for folder in arguments.folders for clip in clips_in(folder)]
        clips += drawn_clips(arguments.drawn)
        if not clips:
            clips = developed_with(arguments.vtest)
    except TruthError as error:
        print(f"grab_truth: {error}", file=sys.stderr)
        return 1
    scores = []
    print(_HEAD, flush=True)
    for clip in with_variants(clips) if arguments.variants else clips:
        score, details = scored(clip, arguments.phases)
        scores.append(score)
        print(_line(score), *(details if arguments.details else ()), sep="\n", flush=True)
    print("\n".join(summary(scores)))
    if arguments.json:
        arguments.json.write_bytes(msgspec.json.format(msgspec.json.encode(scores)))

    # The same over RTSP.
    if arguments.rtsp:
        _rtsp(arguments.vtest)
    return 0


def developed_with(vtest: Path) -> list[Clip]:
    """Return the two clips with which the grabber was developed, as far as they are there."""
    clips = []
    one = one_by_one()
    if one is None:
        print("one-by-one: skipped, clip not found (set --data or CAMTOPOD_TEST_DATA)")
    else:
        clips.append(clip_of(one, HERE / "truth_one_by_one.json", "one-by-one"))
    if not vtest.exists():
        print(f"vtest: skipped, no {vtest} (install Debian's opencv-doc)")
    else:
        clips.append(clip_of(vtest, HERE / "truth_vtest.json", "vtest"))
    return clips


def scored(clip: Clip, phases: int) -> tuple[Score, list[str]]:
    """Analyse a clip ``phases`` times; return its score and the first run's errors in words."""
    runs: list[Run] = []
    details: list[str] = []
    for phase in range(phases):
        # From pictures to events.
        began = time.process_time()
        pipeline = ViewPipeline("cam", clip.settings)
        events = []
        for t, luma in clip.pictures(clip.frames_skipped(phase, phases), clip.settings):
            events += pipeline.process(t, luma)
        events += pipeline.finish()
        cpu_seconds = time.process_time() - began

        # Compare with the truth; what is near a seam counts neither way.
        truth = list(clip.truth)
        result = match(truth, events, clip.aspect)
        found = [i for i, _ in result.pairs if clip.scored(truth[i])]
        missed = [truth[i] for i in result.missed if clip.scored(truth[i])]
        spurious = [events[j] for j in result.spurious if clip.scored(events[j])]
        runs.append(Run(len(found), len(missed), len(spurious), cpu_seconds))
        if phase == 0:
            details = [
                f"    {label} {event.kind} at {event.t:.1f} s ({event.x:.2f}, {event.y:.2f})"
                for label, some in (("missed", missed), ("spurious", spurious))
                for event in some
            ]
    true_events = runs[0].found + runs[0].missed
    return Score(clip.name, clip.variant, clip.seconds, true_events, runs), details


# -- the table ------------------------------

_HEAD = (
    f"{'clip (mean over the runs)':{_NAME}}{'seconds':>8}{'events':>8}{'precision':>11}"
    f"{'recall':>8}{'F1':>7}{'least':>7}{'most':>7}{'CPU s/s':>9}"
)


def _line(score: Score) -> str:
    """Return the line of a clip; one without true events has the number of false ones."""
    title = score.clip + (f", {score.variant}" if score.variant else "")
    line = f"{title:{_NAME}}{score.seconds:>8.0f}{score.true_events:>8}"
    if score.true_events:
        f1 = [run.f1 for run in score.runs]
        line += f"{mean(run.precision for run in score.runs):>11.3f}"
        line += f"{mean(run.recall for run in score.runs):>8.3f}"
        line += f"{score.f1:>7.3f}{min(f1):>7.3f}{max(f1):>7.3f}"
    else:
        line += f"{_false(score):>26.2f} false events"
    return line + f"{score.load:>9.3f}"


def summary(scores: Sequence[Score]) -> list[str]:
    """Return the lines of means over the clips as they are, and over each variant."""
    lines = []
    for variant in dict.fromkeys(score.variant for score in scores):
        some = [score for score in scores if score.variant == variant]
        busy = [score for score in some if score.true_events]
        quiet = [score for score in some if not score.true_events]
        line = f"{variant or 'the clips'}: "
        if busy:
            phases = len(busy[0].runs)
            by_phase = [mean(score.runs[k].f1 for score in busy) for k in range(phases)]
            line += f"mean F1 {mean(by_phase):.3f} ({min(by_phase):.3f} to {max(by_phase):.3f}), "
            line += f"pooled {pooled_f1(busy):.3f}, {len(busy)} clips with "
            line += f"{sum(score.true_events for score in busy)} events; "
        if quiet:
            line += f"{sum(map(_false, quiet)):.2f} false events in "
            line += f"{sum(score.seconds for score in quiet):.0f} s without events; "
        lines.append(line + f"{mean(score.load for score in some):.3f} CPU s/s")
    return lines


def pooled_f1(scores: Sequence[Score]) -> float:
    """Return F1 of the events of all clips and runs together."""
    runs = [run for score in scores for run in score.runs]
    return Run(
        sum(run.found for run in runs),
        sum(run.missed for run in runs),
        sum(run.spurious for run in runs),
        0.0,
    ).f1


def _false(score: Score) -> float:
    """Return the number of spurious events, mean over the runs."""
    return mean(run.spurious for run in score.runs)


# -- RTSP ------------------------------


def _rtsp(vtest: Path) -> None:
    """Serve ``vtest`` once over RTSP and compare the events with those of the file itself."""
    if reason := streams.missing():
        print(f"vtest over RTSP: skipped, {reason}")
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "vtest.mp4"
        streams.transcode(vtest, path, VTEST_FPS)
        grabber = Grabber("cam", str(path), wall_clock=time.time)
        recorded = [event for event in grabber.events() if event is not None]
        streamed: list[Event] = []
        with streams.served(path) as port:
            grabber = Grabber("cam", f"rtsp://127.0.0.1:{port}/camera", wall_clock=time.time)
            for event in grabber.events():
                if event is not None:
                    streamed.append(event)
                if grabber.statistics()["failures"]:
                    break
            grabber.close()

    # Subtract the clock difference before comparing.
    streamed = shifted(streamed, best_offset(recorded, streamed, 4 / 3))
    result = match(recorded, streamed, 4 / 3)
    print(
        f"vtest, RTSP against the file: {len(result.pairs)} events the same, "
        f"{len(result.missed)} missed, {len(result.spurious)} spurious"
    )
    differences = [streamed[j].t - recorded[i].t for i, j in result.pairs]
    if differences:
        print(
            f"    times differ by {np.std(differences):.3f} s (sd), "
            f"{np.abs(differences).max():.3f} s at most"
        )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
