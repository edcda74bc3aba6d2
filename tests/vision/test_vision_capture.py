"""From files and streams to frames: unreadable input, times, pace, and failures of streams."""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rendered_scenes import FPS, HEIGHT, WIDTH, Person, Scene, line

from bench.support.rtsp_streams import FaultProxy, missing, served, transcode
from bench.support.watched_clips import best_offset, match, shifted
from camtopod.records import Event
from camtopod.vision import pipeline
from camtopod.vision.grabber import Grabber
from camtopod.vision.settings import VisionSettings
from camtopod.vision.source import capture, live, recorded
from camtopod.vision.source.capture import Capture
from camtopod.vision.source.recorded import FileOptions, RecordedSource, SourceError

SECONDS = 7.5
TICK_SECONDS = 0.05
needs_server = pytest.mark.skipif(
    missing() is not None, reason=f"needs an RTSP server: {missing()}"
)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Begin, and give up, sooner."""
    monkeypatch.setattr(pipeline, "BOOTSTRAP_SECONDS", 1.0)
    monkeypatch.setattr(live, "BACKOFF_SECONDS_MAX", 0.4)
    monkeypatch.setattr(capture, "CALL_SECONDS_MAX", 1.0)


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a film in which two people walk through."""
    people = [
        Person(line(1.8, (-0.05, 0.55), (1.05, 0.5), 4.0), tall=0.3),
        Person(line(2.2, (1.05, 0.9), (-0.05, 0.95), 4.0), tall=0.3, seed=4),
    ]
    return Scene(people).film(tmp_path_factory.mktemp("film") / "film.mp4", SECONDS)


@pytest.fixture(scope="module")
def server(film: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """Serve the film over RTSP; return the port."""
    path = tmp_path_factory.mktemp("served") / "film.mp4"
    transcode(film, path, FPS)
    with served(path) as port:
        yield port


def grab(source: Path | str, **arguments: object) -> Grabber:
    options: dict[str, Any] = {"settings": VisionSettings(), **arguments}
    return Grabber("cam", str(source), wall_clock=time.time, **options)


def events_of(grabber: Grabber) -> list[Event]:
    return [event for event in grabber.events() if event is not None]


# -- files ------------------------------


def test_a_file_that_is_not_there_or_no_video(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        grab(tmp_path / "none.mp4")
    with pytest.raises(OSError, match="directory"):
        grab(tmp_path)
    (tmp_path / "empty.mp4").touch()
    with pytest.raises(SourceError, match="empty"):
        grab(tmp_path / "empty.mp4")
    (tmp_path / "text.mp4").write_text("no video\n" * 1000)
    with pytest.raises(SourceError, match="not a video"):
        grab(tmp_path / "text.mp4")


def test_times_are_the_start_plus_the_position(film: Path) -> None:
    frames = [
        frame
        for frame in RecordedSource(str(film), VisionSettings(), FileOptions(1000.0)).frames()
        if frame
    ]
    np.testing.assert_allclose(
        [frame.t for frame in frames], 1000.0 + np.arange(len(frames)) / FPS, atol=1e-3
    )

    assert len(frames) == round(SECONDS * FPS)
    assert frames[0].luma.shape == (HEIGHT, WIDTH)


def test_a_file_to_events(film: Path) -> None:
    grabber = grab(film, file_options=FileOptions(1000.0))

    assert grabber.state == "connecting"
    events = sorted(events_of(grabber), key=lambda event: event.t)
    assert [event.kind for event in events] == ["entry", "entry", "exit", "exit"]
    assert all(1001.5 < event.t < 1006.5 for event in events)
    assert grabber.state == "ended"
    figures = grabber.statistics()
    assert (figures["entries"], figures["exits"]) == (2, 2)
    assert figures["frames_analysed"] == figures["frames_grabbed"] == round(SECONDS * FPS)


def test_a_file_at_its_own_pace_has_the_same_events(
    film: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paces = []
    monkeypatch.setattr(recorded, "_until", lambda moment: paces.append(moment) or ())

    paced = events_of(grab(film, file_options=FileOptions(realtime=True)))

    assert SECONDS - 0.5 < paces[-1] - paces[0] < SECONDS
    assert paced == events_of(grab(film))


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="no ffmpeg")
@pytest.mark.parametrize(
    ("encoder", "pixels", "plane", "levels"),
    [
        ("libx264", "yuv420p", True, (16, 235)),
        ("libx264 -colorspace bt709 -color_primaries bt709", "yuv420p", False, (16, 235)),
        ("libx264 -colorspace bt709 -color_range pc", "yuvj420p", False, (0, 255)),
        ("ffv1", "bgr0", False, (0, 255)),
    ],
)
def test_the_decoder_s_plane_is_taken_where_it_is_copied(
    film: Path, tmp_path: Path, encoder: str, pixels: str, plane: bool, levels: tuple[int, int]
) -> None:
    """OpenCV converts luma of BT.709, by way of colours; its levels stay those of the video."""
    path = tmp_path / "film.mkv"
    command = f"ffmpeg -nostdin -loglevel error -i {film} -t 1 -c:v {encoder}".split()
    subprocess.run([*command, "-pix_fmt", pixels, "-q:v", "2", str(path)], check=True)
    capture, twin = (
        Capture(str(path), VisionSettings()),
        cv2.VideoCapture(str(path), cv2.CAP_FFMPEG),
    )

    assert (capture._capture.get(cv2.CAP_PROP_CONVERT_RGB) == 0.0) == plane
    seen = []
    for _ in range(3):
        assert capture.grab() is not None
        luma, (_, picture) = capture.retrieve(), twin.read()
        assert luma is not None
        assert luma.shape == (HEIGHT, WIDTH)
        grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        assert np.corrcoef(luma.ravel(), grey.ravel())[0, 1] > 0.99
        wanted = np.interp(grey, (0, 255), levels)
        assert abs(luma.mean() - wanted.mean()) < 1.5
        seen.append(luma)
    assert not np.shares_memory(seen[0], seen[1])
    capture.release()
    twin.release()


@pytest.mark.parametrize("options", ["hw_decoders_any;vaapi", "video_codec;mpeg4"])
def test_ffmpeg_s_options_are_handed_on(
    film: Path, options: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A named decoder is used if there is one; software takes over where no device works."""
    monkeypatch.setenv("OPENCV_FFMPEG_CAPTURE_OPTIONS", options)
    kinds = [event.kind for event in events_of(grab(film))]
    assert sorted(kinds) == ["entry", "entry", "exit", "exit"]

    monkeypatch.setenv("OPENCV_FFMPEG_CAPTURE_OPTIONS", "video_codec;no_such_decoder")
    with pytest.raises(SourceError):
        grab(film)


# -- streams ------------------------------


def run_until(
    stream: Iterator[Event | None], condition: Callable[[], bool], seconds: float = 15.0
) -> list[Event]:
    """Return events until ``condition``; control must return at least once a second.

    A moment in which the machine does nothing, not for another process either, does not count.
    """
    events: list[Event] = []
    with ticks() as count:
        began = heard = count()
        for event in stream:
            now = count()
            assert now - heard < 1.5 / TICK_SECONDS, "the caller was kept waiting"
            heard = now
            if event is not None:
                events.append(event)
            if condition():
                return events
            assert now - began < seconds / TICK_SECONDS, "it took too long"
    raise AssertionError("a stream never ends")


@contextlib.contextmanager
def ticks() -> Iterator[Callable[[], int]]:
    """Count for how many times `TICK_SECONDS` the machine has let another process sleep."""
    command = ["sh", "-c", f"while sleep {TICK_SECONDS}; do printf .; done"]
    with tempfile.TemporaryFile() as file, subprocess.Popen(command, stdout=file) as ticking:
        try:
            yield lambda: os.fstat(file.fileno()).st_size
        finally:
            ticking.terminate()


def test_a_stream_that_is_not_there_is_waited_for() -> None:
    with socket.socket() as reserved:
        reserved.bind(("127.0.0.1", 0))  # bound, not listening: refuses
        grabber = grab(f"rtsp://user:pa@ss@127.0.0.1:{reserved.getsockname()[1]}/s")

        assert run_until(grabber.events(), lambda: grabber.statistics()["failures"] >= 2) == []
        assert grabber.state == "connecting"
        assert "trying again" in grabber.reason
        assert "ss@" not in grabber.reason
        grabber.close()


@needs_server
def test_a_stream_has_the_events_of_the_file(film: Path, server: int) -> None:
    recorded = events_of(grab(film))
    grabber = grab(f"rtsp://127.0.0.1:{server}/camera")
    before = time.time()
    streamed = run_until(grabber.events(), lambda: grabber.statistics()["exits"] >= 2, SECONDS + 10)
    grabber.close()

    assert all(before < event.t < time.time() for event in streamed)
    aspect = WIDTH / HEIGHT
    offset = best_offset(recorded, streamed, aspect)
    result = match(recorded, shifted(streamed, offset), aspect)
    assert result.f1 == 1.0
    differences = [streamed[j].t - offset - recorded[i].t for i, j in result.pairs]
    assert np.abs(differences).max() < 0.3
    assert grabber.statistics()["untrusted_stamps"] <= 2


@needs_server
def test_a_stream_that_stalls_closes_or_refuses_comes_back(
    server: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "OBSERVED_SECONDS", 0.0)  # as one that ran for long: no patience
    proxy = FaultProxy(server)
    grabber = grab(f"rtsp://127.0.0.1:{proxy.port}/camera")
    stream, analysed = grabber.events(), 0

    def more_frames() -> bool:
        return grabber.state == "running" and grabber.statistics()["frames_analysed"] > analysed + 2

    run_until(stream, more_frames)
    proxy.stall()
    run_until(stream, lambda: grabber.state == "stalled")
    assert "read timeout" in grabber.reason
    proxy.cut()
    proxy.resume()
    analysed = int(grabber.statistics()["frames_analysed"])
    run_until(stream, more_frames)
    proxy.refusing = True
    proxy.cut()
    run_until(stream, lambda: grabber.statistics()["failures"] >= 3)
    assert grabber.state == "stalled"
    proxy.refusing = False
    analysed = int(grabber.statistics()["frames_analysed"])
    run_until(stream, more_frames)
    grabber.close()
    proxy.close()
