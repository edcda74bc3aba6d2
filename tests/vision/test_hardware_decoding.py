"""Hardware decoding: what is there, what is asked for, and that software takes over."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from msgspec.structs import replace
from rendered_scenes import Person, Scene, line

from camtopod.records import Event
from camtopod.vision import Grabber, VisionSettings
from camtopod.vision.source import capture as captures
from camtopod.vision.source import hardware
from camtopod.vision.source.capture import Capture
from camtopod.vision.source.hardware import Kind, Support

ANY = VisionSettings(hardware_decoding="any")
NOTHING = tuple(Support(kind, built=False, device=False) for kind in hardware.KINDS)


@pytest.fixture(autouse=True)
def _as_in_a_new_process() -> Iterator[None]:
    hardware._failed.clear()
    captures._log_once.cache_clear()
    yield
    hardware._failed.clear()
    captures._log_once.cache_clear()


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Somebody walks through the picture."""
    person = Person(line(4.0, (-0.1, 0.8), (1.1, 0.8), 7.0), tall=0.3)
    return Scene([person]).film(tmp_path_factory.mktemp("film") / "yard.mp4", 14.0)


def having(monkeypatch: pytest.MonkeyPatch, *kinds: Kind) -> None:
    """Let the machine have these kinds, and no other."""
    found = tuple(one._replace(built=one.kind in kinds, device=True) for one in NOTHING)
    monkeypatch.setattr(hardware, "support", lambda: found)


def events_of(film: Path, settings: VisionSettings) -> list[Event | None]:
    grabber = Grabber("cam", str(film), wall_clock=time.time, settings=settings)
    return [event for event in grabber.events() if event is not None]


def test_this_build_is_asked() -> None:
    """FFmpeg's libraries that OpenCV has loaded know software decoders at least."""
    assert [one.kind for one in hardware.support()] == ["vaapi", "cuda", "v4l2"]
    assert hardware._has_decoder("mpeg4") in (True, None)
    assert not hardware._has_decoder("no_such_decoder")
    for title in ("VAAPI: ", "CUDA: ", "V4L2: "):
        assert title in hardware.describe()


def test_words() -> None:
    assert Support("cuda", built=False, device=True).words == "CUDA: not in this build of FFmpeg"
    there = Support("vaapi", built=True, device=True)
    assert there.words == "VAAPI: in this build, a usable device (/dev/dri/renderD*)"
    unknown = Support("v4l2", built=None, device=False)
    assert unknown.words == "V4L2: maybe in this build, no usable device (/dev/video*)"
    assert (there.usable, unknown.usable, unknown._replace(device=True).usable) == (
        True,
        False,
        True,
    )


def test_kinds_that_cannot_work_are_not_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    having(monkeypatch, "vaapi", "v4l2")
    assert hardware.kinds_for("none") == ()
    assert hardware.kinds_for("any") == ("vaapi", "v4l2")
    assert hardware.kinds_for("cuda") == ()
    assert hardware.kinds_for("v4l2") == ("v4l2",)
    hardware.give_up("v4l2")
    assert hardware.kinds_for("any") == ("vaapi",)
    assert hardware.device_options(("vaapi", "cuda", "v4l2")) == "hw_decoders_any;vaapi,cuda"
    assert hardware.device_options(("v4l2",)) == ""


@pytest.mark.parametrize("kinds", [(), ("vaapi", "cuda"), ("v4l2",)])
def test_software_takes_over_in_a_sentence(
    film: Path,
    kinds: tuple[Kind, ...],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Whether nothing is there, a device does not work, or a codec has no decoder."""
    having(monkeypatch, *kinds)
    expected = events_of(film, VisionSettings())
    assert len(expected) == 2
    assert caplog.messages == []
    with caplog.at_level(logging.INFO):
        for _ in range(2):
            assert events_of(film, ANY) == expected
    (sentence,) = caplog.messages
    assert sentence.startswith(
        "hardware_decoding = any does not work here, so pictures are decoded in software ("
    )
    assert ("could not be decoded with it" in sentence) == bool(kinds)


def test_a_decoder_that_does_not_open_is_not_tried_again(
    film: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    having(monkeypatch, "v4l2")
    monkeypatch.setattr(hardware, "_has_decoder", lambda name: True)
    monkeypatch.setattr(hardware, "V4L2_DECODERS", {"fmp4": "no_such_decoder"})
    for _ in range(2):
        capture = Capture(str(film), replace(ANY, hardware_decoding="v4l2"))
        assert (capture.is_open, capture.decoding) == (True, "software")
        assert capture.grab() is not None
        capture.release()
        assert hardware.kinds_for("v4l2") == ()
    assert len(caplog.messages) == 1


def test_a_decoder_for_the_codec_is_taken(film: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """FFmpeg's own one stands for that of V4L2."""
    having(monkeypatch, "v4l2")
    monkeypatch.setattr(hardware, "V4L2_DECODERS", {"fmp4": "mpeg4"})
    capture = Capture(str(film), ANY)
    assert (capture.is_open, capture.decoding) == (True, "hardware")
    assert capture.grab() is not None
    luma = capture.retrieve()
    assert luma is not None
    assert luma.shape == (144, 192)
    capture.release()


def test_options_of_the_user_are_kept(film: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    with captures._environment(True, "hw_decoders_any;vaapi"):
        seen.append(os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"])
    assert "OPENCV_FFMPEG_CAPTURE_OPTIONS" not in os.environ
    monkeypatch.setenv("OPENCV_FFMPEG_CAPTURE_OPTIONS", "rtsp_transport;udp")
    with captures._environment(True, "hw_decoders_any;vaapi"):
        seen.append(os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"])
    assert os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] == "rtsp_transport;udp"
    assert seen == [
        f"{captures.STREAM_OPTIONS}|hw_decoders_any;vaapi",
        "rtsp_transport;udp|hw_decoders_any;vaapi",
    ]
