"""Measure the cost of a camera: CPU time a frame of the grabber, of decoding alone, of Frigate.

    python -m bench grab [--rounds 7] [--seconds 40] [--crf 20] [--films FOLDER] [--json FILE]

Films of 1080p and 720p at 25 frames a second, H.264, are rendered first (two minutes; FOLDER keeps
them): a busy one that a dozen people cross all the time, and a quiet one that a single person
crosses now and then. Everything decodes in software. Decoding alone is OpenCV's capture opened as
the grabber opens it, every frame grabbed, none retrieved. Needs the program ffmpeg with libx264.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import cv2

from bench.baselines import frigate
from bench.support import films, ratios
from bench.support.parts import part_parser
from camtopod.vision.grabber import Grabber

DECODING = "decoding alone"
GRABBER = "the grabber"
ROUNDS, SECONDS = 7, 40.0
SMALL_DETECT = (640, 360)
"""Second detect size of Frigate, (width, height)."""
SIZES = {"1080p": (1920, 1080), "720p": (1280, 720)}
"""Sizes of the films, (width, height)."""
SCENES = {"busy": (12, 0.5), "quiet": (1, 20.0)}
"""People in each scene, and the seconds that each is out of view between two crossings."""
RATIO_MAX = {
    ("1080p", "busy"): 1.25,
    ("1080p", "quiet"): 1.35,
    ("720p", "busy"): 1.5,
    ("720p", "quiet"): 1.5,
}
"""Targets of the grabber's ratio to decoding alone, by size and scene."""


class Film(NamedTuple):
    """A film to measure on."""

    size_name: str
    scene: str
    size: tuple[int, int]
    path: Path
    frames: int

    @property
    def title(self) -> str:
        """Size, scene and bit rate."""
        rate = 8e-6 * self.path.stat().st_size * films.FPS / self.frames
        return f"{self.size_name} {self.scene}, {rate:.1f} Mbit/s"


def main(argv: list[str]) -> int:
    """Print the tables and return the exit status."""
    parser = part_parser(__name__, __doc__)
    ratios.add_arguments(parser, ROUNDS)
    parser.add_argument("--seconds", type=float, default=SECONDS, help="length of a film")
    parser.add_argument("--films", type=Path, metavar="FOLDER", help="folder to keep the films in")
    parser.add_argument(
        "--crf", type=int, default=films.CRF, help="quality of the films: lower is more bits"
    )
    parser.add_argument("--sizes", nargs="+", choices=SIZES, default=list(SIZES))
    arguments = parser.parse_args(argv)
    if shutil.which("ffmpeg") is None:
        print("bench grab: the program ffmpeg is missing; install it", file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory() as folder:
        tables = []
        for film in made_films(
            arguments.films or Path(folder), arguments.sizes, arguments.seconds, arguments.crf
        ):
            tables.append(measure(film, arguments.rounds))
            print("\n".join(ratios.lines(tables[-1])), seen(film), sep="\n", end="\n\n", flush=True)
    ratios.write(arguments.json, "grab", tables, opencv=cv2.__version__, ffmpeg=ffmpeg_version())
    return 0


def made_films(folder: Path, sizes: list[str], seconds: float, crf: int) -> list[Film]:
    """Return the films in ``folder``; those that are missing are rendered."""
    folder.mkdir(parents=True, exist_ok=True)
    result = []
    for size_name in sizes:
        for scene, (count, pause) in SCENES.items():
            path = folder / f"{size_name}-{scene}-{seconds:g}s-crf{crf}.mp4"
            if not path.exists():
                part = path.with_suffix(".part.mp4")
                films.film(part, SIZES[size_name], films.people(count, pause, seed=3), seconds, crf)
                part.rename(path)
            result.append(
                Film(size_name, scene, SIZES[size_name], path, round(seconds * films.FPS))
            )
    return result


def measure(film: Film, rounds: int) -> ratios.Table:
    """Measure the CPU milliseconds a frame of every contestant."""

    def per_frame(run: Callable[..., object], *arguments: object) -> Callable[[], float]:
        return lambda: 1000 * ratios.cpu_seconds_of(lambda: run(film, *arguments)) / film.frames

    contestants = {
        DECODING: per_frame(decode),
        GRABBER: per_frame(grab),
        frigate_at(film.size): per_frame(run_frigate, film.size),
        frigate_at(SMALL_DETECT): per_frame(run_frigate, SMALL_DETECT),
        "the program ffmpeg, decoding alone": per_frame(decode_by_ffmpeg),
    }
    costs = ratios.take_turns(contestants, rounds)
    targets = {GRABBER: RATIO_MAX[film.size_name, film.scene]}
    return ratios.compare(film.title, "CPU ms a frame", costs, DECODING, targets)


def frigate_at(detect: tuple[int, int]) -> str:
    """Return the contestant's name."""
    return f"Frigate's method, detect {detect[0]}x{detect[1]}"


def decode(film: Film) -> None:
    """Grab every frame, retrieve none."""
    capture = cv2.VideoCapture(str(film.path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
    frames = 0
    while capture.grab():
        frames += 1
    capture.release()
    assert frames == film.frames, f"{frames} frames instead of {film.frames}"


def grab(film: Film) -> Grabber:
    """Run the whole grabber, pixels to events."""
    grabber = Grabber("cam", str(film.path), wall_clock=time.time)
    for _ in grabber.events():
        pass
    assert grabber.statistics()["frames_grabbed"] == film.frames
    return grabber


def run_frigate(film: Film, detect: tuple[int, int]) -> None:
    """Pipe raw frames from ffmpeg and detect motion with OpenCV, as Frigate does."""
    frames, _ = frigate.watch(film.path, *detect)
    assert abs(frames - film.frames * frigate.FPS / films.FPS) <= 2, f"{frames} frames looked at"


def decode_by_ffmpeg(film: Film) -> None:
    """Decode with another build of the same decoder, one thread; shows how far decoders differ."""
    command = [
        "ffmpeg",
        "-nostdin",
        "-loglevel",
        "error",
        "-threads",
        "1",
        "-i",
        str(film.path),
        "-f",
        "null",
        "-",
    ]
    subprocess.run(command, check=True)


def seen(film: Film) -> str:
    """Return a line about the grabber's work: frames analysed, entries and exits."""
    figures = grab(film).statistics()
    ms = 1e3 * float(figures["analysis_cpu_seconds"]) / float(figures["frames_analysed"])
    return (
        f"  the grabber analysed {figures['frames_analysed']} of {film.frames} frames and saw "
        f"{figures['entries']} entries and {figures['exits']} exits; analysis {ms:.2f} ms a frame"
    )


def ffmpeg_version() -> str:
    """Return the first line of ``ffmpeg -version``."""
    output = subprocess.run(
        ["ffmpeg", "-version"], capture_output=True, check=True, text=True
    ).stdout
    return output.splitlines()[0]
