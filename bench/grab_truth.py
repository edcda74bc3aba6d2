"""Score the grabber's events on real clips against ground truth.

    python -m bench grab_truth [FOLDER...] [--model FILE [--warm]] [--variants] [--details]
                               [--json FILE] [--against FILE] [--data FOLDER]
                               [--leave-out-kinds MODULE:NAME=VALUES]

Each FOLDER holds clips and their truth: NAME.mp4 with NAME.jsonl, a line for each event,
``{"kind": "entry", "t": 8.25, "x": 0.31, "y": 0.88}`` (seconds from the beginning of the file, foot
point in fractions of the picture; an empty file stands for a clip without events); with NAME.json,
passages by frame number as in bench/support/truth_vtest.json; or a truth.json for several clips,
with areas and events that do not count (bench/support/truth_clips.py). Without a FOLDER it scores
the two clips with which the grabber was developed: one-by-one/ of --data (default: the
environment's CAMTOPOD_TEST_DATA) and Debian's vtest.avi.

An event counts as found within 1.5 s and 0.12 of the picture's diagonal of a true one of its kind,
one to one, the nearest first. As a clip's figures vary with the pictures that happen to be taken,
each is analysed four times: without the first 0, 1/4, 1/2, 3/4 of the time from one picture to the
next. The mean over the clips has its standard error; ``--against`` compares with the FILE of an
earlier ``--json``, clip by clip: a difference below its standard error is none.

If the truth tells kinds of view, the means are also over kinds. ``--leave-out-kinds`` chooses a
constant of camtopod.vision on all kinds but one, for each of them, and scores it there, beside the
present value.

A camera's detector is trusted once it has seen most of what moves there. ``--warm`` scores a clip
with the trust of such a camera that has run for days: learned on a first pass of the clip, whose
events do not count.

``--variants`` adds what can be made of the clips: mirrored, backwards in time, cropped where nobody
enters or leaves, with half the light, in haze, shaken, slowed, begun later, with a bush in the
wind, and two side by side, each with its truth changed accordingly.
"""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Sequence
from copy import copy
from functools import partial
from pathlib import Path
from statistics import mean, stdev

import msgspec
from msgspec import Struct

from bench.support import clip_kinds
from bench.support.clip_variants import with_variants
from bench.support.figures import line_of
from bench.support.parts import part_parser
from bench.support.truth_clips import Clip, TruthError, clip_of, clips_in
from bench.support.watched_clips import HERE, VTEST, one_by_one
from camtopod.records import Event
from camtopod.vision.detector.detector import Detector
from camtopod.vision.detector.model import DetectorModel
from camtopod.vision.pipeline import ViewPipeline
from camtopod.vision.settings import DetectorSettings

PHASES = 4
"""Times that each clip is analysed, with other pictures of it."""
_NAME = 44
"""Width of the column of names."""


class Run(Struct):
    """One analysis of a clip: numbers of events, and seconds."""

    found: int
    missed: int
    spurious: int
    cpu_seconds: float
    """Processor time, with decoding."""
    latest_seconds: float
    """Longest time from an event until it is told, in the time of the video."""
    blind_seconds: float = 0.0
    """Time for which nothing could be told from the pictures."""

    @property
    def precision(self) -> float:
        """Share of the reported events that are true; 1.0 if there are none."""
        reports = self.found + self.spurious
        return self.found / reports if reports else 1.0

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
    kind: str = ""
    """Kind of view; "" if the truth does not say."""

    @property
    def f1(self) -> float:
        """Mean over the runs."""
        return mean(run.f1 for run in self.runs)

    @property
    def key(self) -> tuple[str, str]:
        """Identify the clip in a file of figures."""
        return self.clip, self.variant

    @property
    def load(self) -> float:
        """Processor seconds for each second of video, mean over the runs."""
        return mean(run.cpu_seconds for run in self.runs) / self.seconds


def main(argv: list[str]) -> int:
    """Print the table and return the exit status."""
    parser = part_parser(__name__, __doc__)
    add = parser.add_argument
    add("folders", nargs="*", type=Path, metavar="FOLDER", help="clips with their truth")
    add("--model", metavar="FILE", help="with this detector, an ONNX file")
    add("--warm", action="store_true", help="trust the detector as learned on a first pass")
    add("--variants", action="store_true", help="also variants of the clips")
    add("--details", action="store_true", help="list missed and spurious events of the first run")
    add("--json", type=Path, metavar="FILE", help="also write the figures there")
    add("--against", type=Path, metavar="FILE", help="compare with the figures of an earlier run")
    add(
        "--leave-out-kinds",
        type=clip_kinds.choice_of,
        metavar="MODULE:NAME=VALUES",
        help="choose a constant of camtopod.vision (detect.blobs:DENSE_SHARE=0.3,0.5) on all kinds"
        " of clips but one, and score it on that one, for each kind",
    )
    add("--data", metavar="FOLDER", help="folder with one-by-one/")
    arguments = parser.parse_args(argv)
    if arguments.model and arguments.variants:
        parser.error("variants are without colour, which a model needs")
    if arguments.warm and not arguments.model:
        parser.error("--warm needs a --model")
    if arguments.data:
        os.environ["CAMTOPOD_TEST_DATA"] = arguments.data

    # Score the clips.
    detector, colour = detector_of(arguments.model), bool(arguments.model)
    try:
        clips = [clip for folder in arguments.folders for clip in clips_in(folder, colour=colour)]
        clips = clips if arguments.folders else developed_with(colour=colour)
    except TruthError as error:
        print(f"grab_truth: {error}", file=sys.stderr)
        return 1
    score_of = partial(scored, phases=PHASES, detector=detector, warm=arguments.warm)
    if arguments.leave_out_kinds:
        print("\n".join(chosen(clips, arguments.leave_out_kinds, score_of)))
        return 0
    scores = []
    print(_HEAD, flush=True)
    for clip in with_variants(clips) if arguments.variants else clips:
        score, details = score_of(clip)
        scores.append(score)
        print(_line(score), *(details if arguments.details else ()), sep="\n", flush=True)

    # Means, and differences from an earlier run.
    print("\n".join(summary(scores)))
    if arguments.against:
        earlier = msgspec.json.decode(arguments.against.read_bytes(), type=list[Score])
        print("\n".join(compared(scores, earlier)))
    if arguments.json:
        arguments.json.write_bytes(msgspec.json.format(msgspec.json.encode(scores)))
    return 0


def developed_with(*, colour: bool = False) -> list[Clip]:
    """Return the two clips with which the grabber was developed, as far as they are there."""
    clips = []
    path = one_by_one()
    if path is None:
        print("one-by-one: skipped, clip not found (set --data or CAMTOPOD_TEST_DATA)")
    else:
        clips.append(clip_of(path, HERE / "truth_one_by_one.json", "one-by-one", colour=colour))
    if not VTEST.exists():
        print(f"vtest: skipped, no {VTEST} (install Debian's opencv-doc)")
    else:
        clips.append(clip_of(VTEST, HERE / "truth_vtest.json", "vtest", colour=colour))
    return clips


def detector_of(model: str | None) -> Callable[[], Detector | None]:
    """Return a function that makes a new detector with a model, an ONNX file; or none."""
    if not model:
        return lambda: None
    settings = DetectorSettings(model=model)
    detector_model = DetectorModel(settings)
    return lambda: Detector(detector_model, settings)


def grabbed(
    clip: Clip, phase: int, phases: int = PHASES, detector: Detector | None = None
) -> tuple[list[Event], list[float], float]:
    """Return the events of a clip, how long after each it is told, and the time of blindness.

    Times are in seconds of the video.

    phase: part of the time between two pictures that is left out at the beginning, of ``phases``.
    """
    pipeline = ViewPipeline("cam", clip.settings, detector=detector)
    events: list[Event] = []
    delays: list[float] = []
    t, left_out = 0.0, phase / phases / clip.settings.analysed_fps
    for t, luma, image in clip.pictures(left_out, clip.settings):
        events += pipeline.process(t, luma, image)
        delays += [t - event.t for event in events[len(delays) :]]
    events += pipeline.finish()
    delays += [t - event.t for event in events[len(delays) :]]
    return events, delays, float(pipeline.statistics()["blind_seconds"])


def scored(
    clip: Clip,
    phases: int,
    detector: Callable[[], Detector | None] = lambda: None,
    warm: bool = False,
) -> tuple[Score, list[str]]:
    """Analyse a clip ``phases`` times; return its score and the first run's errors in words.

    warm: each of the detectors begins with the trust that another has learned on the clip.
    """
    runs: list[Run] = []
    details: list[str] = []
    warm_detector = detector() if warm else None
    if warm_detector is not None:
        grabbed(clip, 0, phases, warm_detector)
    for phase in range(phases):
        phase_detector = detector()
        if phase_detector is not None and warm_detector is not None:
            phase_detector.trust = copy(warm_detector.trust)
        start = time.process_time()
        events, delays, blind_seconds = grabbed(clip, phase, phases, phase_detector)
        cpu_seconds = time.process_time() - start
        pairs, misses, _, spurious = clip.judged(events)
        runs.append(
            Run(
                len(pairs),
                len(misses),
                len(spurious),
                cpu_seconds,
                max(delays, default=0.0),
                blind_seconds,
            )
        )
        if phase == 0:
            details = [
                f"    {label} {event.kind} at {event.t:.1f} s ({event.x:.2f}, {event.y:.2f})"
                for label, errors in (("missed", misses), ("spurious", spurious))
                for event in errors
            ]
    score = Score(clip.name, clip.variant, clip.seconds, len(clip.truth), runs, clip.kind)
    return score, details


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
        selection = [score for score in scores if score.variant == variant]
        busy = [score for score in selection if score.true_events]
        quiet = [score for score in selection if not score.true_events]
        line = f"{variant or 'the clips'}: "
        if busy:
            phases = len(busy[0].runs)
            by_phase = [mean(score.runs[k].f1 for score in busy) for k in range(phases)]
            line += f"mean F1 {mean(by_phase):.3f}, standard error over clips "
            line += f"{standard_error([score.f1 for score in busy]):.3f} "
            line += f"(phases {' '.join(f'{value:.3f}' for value in by_phase)}), "
            line += f"pooled {pooled_f1(busy):.3f}, {len(busy)} clips with "
            line += f"{sum(score.true_events for score in busy)} events; "
        if quiet:
            line += f"{false_events(quiet):.2f} false events in "
            line += f"{sum(score.seconds for score in quiet):.0f} s without events; "
        latest = max(run.latest_seconds for score in selection for run in score.runs)
        line += f"latest event told {latest:.1f} s after its time; "
        blind_seconds = sum(mean(run.blind_seconds for run in score.runs) for score in selection)
        line += (
            f"blind {blind_seconds / sum(score.seconds for score in selection):.1%} of the time; "
        )
        lines.append(line + f"{mean(score.load for score in selection):.3f} CPU s/s")
        if len(f1 := f1_by_kind(selection)) > 1:
            lines.append(clip_kinds.by_kind(f1))
        kinds = {kind: mean(values) for kind, values in f1.items()}
        name = variant or "clips"
        lines += [line_of(f"{name}, {kind}", value) for kind, value in kinds.items()]
        if len(kinds) > 1:
            error = standard_error(list(kinds.values()))
            lines.append(line_of(f"{name}, mean over kinds", mean(kinds.values()), error))
        lines += [line_of(f"{score.clip}, {name}", score.f1) for score in busy]
        lines.append(line_of(f"{name}, false events without any", false_events(selection)))
    return lines


def false_events(scores: Sequence[Score]) -> float:
    """Return the number of false events, mean over the runs, in the clips without events."""
    return sum(_false(score) for score in scores if not score.true_events)


def f1_by_kind(scores: Sequence[Score]) -> dict[str, list[float]]:
    """Return F1 of the clips with events, by kind of view."""
    result: dict[str, list[float]] = {}
    for score in scores:
        if score.true_events and score.kind:
            result.setdefault(score.kind, []).append(score.f1)
    return result


def chosen(
    clips: Sequence[Clip],
    choice: clip_kinds.Choice,
    score_of: Callable[[Clip], tuple[Score, list[str]]],
) -> list[str]:
    """Return the lines of a constant that is chosen on all kinds but one, each left out once."""
    f1, present = {}, choice.present
    for value in dict.fromkeys([present, *choice.values]):
        choice.set(value)
        scores = [score_of(clip)[0] for clip in clips]
        f1[value] = {kind: mean(values) for kind, values in f1_by_kind(scores).items()}
    choice.set(present)
    return clip_kinds.leave_out_kinds(f1, present)


def compared(scores: Sequence[Score], earlier: Sequence[Score]) -> list[str]:
    """Return a line for each variant: difference of the mean F1, on the clips that both have."""
    before = {score.key: score for score in earlier if score.true_events}
    lines = []
    for variant in dict.fromkeys(score.variant for score in scores):
        common = [score for score in scores if score.variant == variant and score.key in before]
        line = f"{variant or 'the clips'}, against the earlier run: "
        if not common:
            lines.append(line + "no clip in common")
            continue
        changes = [score.f1 - before[score.key].f1 for score in common]
        change, error = mean(changes), standard_error(changes)
        pooled = pooled_f1(common) - pooled_f1([before[score.key] for score in common])
        line += f"mean F1 {change:+.3f}, standard error {error:.3f} over {len(common)} clips, "
        line += f"pooled {pooled:+.3f}: "
        if abs(change) <= error or not change:
            line += "no difference (not above its standard error)"
        else:
            line += "better" if change > 0 else "worse"
        lines.append(line)
    return lines


def standard_error(values: Sequence[float]) -> float:
    """Return the standard error of the mean; it is infinite for a single value."""
    return stdev(values) / math.sqrt(len(values)) if len(values) > 1 else math.inf


def pooled_f1(scores: Sequence[Score]) -> float:
    """Return F1 of the events of all clips and runs together."""
    runs = [run for score in scores for run in score.runs]
    found, missed, spurious = (
        sum(getattr(run, name) for run in runs) for name in ("found", "missed", "spurious")
    )
    return Run(found, missed, spurious, 0.0, 0.0).f1


def _false(score: Score) -> float:
    """Return the number of spurious events, mean over the runs."""
    return mean(run.spurious for run in score.runs)
