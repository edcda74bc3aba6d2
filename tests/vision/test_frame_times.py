"""Capture times from stamps and arrivals; selection of frames; spellings of sources."""

from __future__ import annotations

import numpy as np
import pytest

from camtopod.vision.source.capture import FrameSelector
from camtopod.vision.source.file_times import FileTimes
from camtopod.vision.source.frame_times import StampClock
from camtopod.vision.source.source_url import percent_encoded


def errors(stamps: np.ndarray, truth: np.ndarray, delays: np.ndarray) -> np.ndarray:
    """Return the errors of the estimated capture times, seconds."""
    clock = StampClock()
    found = []
    for stamp, t, delay in zip(stamps, truth, delays, strict=True):
        clock.record(float(stamp), float(t + delay))
        captured = clock.captured(float(stamp), float(t + delay))
        found.append(t + delay if captured is None else captured)
    return np.array(found) - truth


def test_delays_that_vary_are_taken_out() -> None:
    captured = 1000.0 + np.arange(2000) / 15
    delays = 0.03 + np.random.default_rng(1).exponential(0.1, 2000)
    found = errors(captured - 990.0, captured, delays)
    assert np.abs(found[100:] - 0.03).max() < 0.02, "what is left is the smallest delay"
    assert delays.std() > 0.08


@pytest.mark.parametrize("rate", [0.0001, 1 / 90, 0.2, 0.84, 0.98, 1.0001, 1.02, 1.68, 90.0])
@pytest.mark.parametrize("fps", [5, 25])
def test_stamps_at_a_wrong_rate_give_way_to_arrivals(rate: float, fps: float) -> None:
    captured = 1000.0 + np.arange(round(60 * fps)) / fps
    delays = 0.05 + np.random.default_rng(1).exponential(0.03, len(captured))
    found = errors((captured - 990.0) * rate, captured, delays)
    assert np.abs(found[captured > 1004.0]).max() < 0.5


@pytest.mark.parametrize("seconds", [2.0, 6.0, 10.0])
def test_pictures_that_come_in_bursts_keep_their_distances(seconds: float) -> None:
    captured = 1000.0 + np.arange(1500) / 25
    delays = seconds - (captured - 1000.0) % seconds
    found = errors(captured - 990.0, captured, delays)
    assert np.ptp(found[captured >= 1000.0 + seconds]) < 0.01


def test_segments_that_are_asked_for_now_and_then_keep_their_distances() -> None:
    captured = 1000.0 + np.arange(3000) / 25
    whole = np.ceil((captured - 999.99) / 2.0) * 2.0
    delays = 1000.0 + np.ceil(whole / 2.07) * 2.07 - captured
    found = errors(captured - 990.0, captured, delays)
    assert np.sum(np.abs(np.diff(found[250:])) > 0.1) < 5, "it changes when one comes sooner"


def test_a_new_time_base_begins_anew() -> None:
    captured = 1000.0 + np.arange(200) / 10
    stamps = np.where(np.arange(200) < 100, captured - 990.0, captured - 1009.0)
    assert np.abs(errors(stamps, captured, np.full(200, 0.1))).max() < 0.11
    stamps = np.where(np.arange(200) < 100, captured - 990.0, captured + 5000.0)
    assert np.abs(errors(stamps, captured, np.full(200, 0.1))).max() < 0.11


@pytest.mark.parametrize("stamp", [0.0, -1.0, float("nan"), float("inf")])
def test_what_is_no_stamp_is_not_trusted(stamp: float) -> None:
    clock = StampClock()
    clock.record(stamp, 50.0)
    assert clock.captured(stamp, 50.0) is None


@pytest.mark.parametrize("declared", [12.5, 25.0, 12.4, 0.0])
@pytest.mark.parametrize("spacing", [2, 9, 40])
@pytest.mark.parametrize("pause", [0.0, 0.5, 90.0, -200.0])
def test_frames_of_a_file_that_have_no_stamp_are_counted(
    declared: float, spacing: int, pause: float
) -> None:
    """The frames pause meanwhile; if that is negative, the stamps begin anew."""
    truth = np.arange(4000) / 12.5
    truth[2000:] += max(0.0, pause)
    has_stamp = np.random.default_rng(spacing).random(4000) < 1 / spacing
    stamps = np.where(has_stamp, truth + np.where(truth >= 160.0, min(0.0, pause), 0.0), 0.0)

    times = FileTimes(declared)
    positions = np.array([position for stamp in stamps for position in times.place(stamp)])
    positions = np.append(positions, times.rest())

    error = np.abs(positions - truth)
    assert (np.diff(positions) > 0.0).all()
    assert error[300:1900].max() < 0.1
    assert error[2200:].max() < (0.1 if pause >= 0.0 else 0.5), "when it began anew is not known"
    assert times.untrusted_count <= 1


@pytest.mark.parametrize(
    ("fps", "wanted", "taken"),
    [
        (7.0, 7.0, 7.0),
        (10.0, 7.0, 10.0),
        (15.0, 7.0, 7.5),
        (25.0, 7.0, 6.25),
        (30.0, 7.0, 7.5),
        (5.0, 7.0, 5.0),
    ],
)
def test_cadence_is_the_nearest_even_one(fps: float, wanted: float, taken: float) -> None:
    cadence = FrameSelector(wanted)
    count = sum(cadence.wants(k / fps) for k in range(round(20 * fps)))
    assert count / 20 == pytest.approx(taken, rel=0.05)


@pytest.mark.parametrize(
    ("url", "encoded"),
    [
        ("rtsp://user:p@ss:w/rd@host/path", "rtsp://user:p%40ss%3Aw%2Frd@host/path"),
        ("rtsp://user:p@ss:w/rd@host", "rtsp://user:p%40ss%3Aw%2Frd@host"),
        ("rtsp://us er:plain@10.0.0.5:554/s?a=b@c", "rtsp://us%20er:plain@10.0.0.5:554/s?a=b@c"),
        ("rtsp://user:p%40ss@host:554/s", "rtsp://user:p%40ss@host:554/s"),
        ("rtsp://user:50%@host/s", "rtsp://user:50%25@host/s"),
        ("rtsp://user:x?y#z@[fe80::1]:554/s", "rtsp://user:x%3Fy%23z@[fe80::1]:554/s"),
        ("rtsp://user@host/s", "rtsp://user@host/s"),
        ("rtsp://host:554/stream@1", "rtsp://host:554/stream@1"),
        ("rtsp://u:p@ss/word@10.0.0.5/s", "rtsp://u:p%40ss%2Fword@10.0.0.5/s"),
        ("rtsp://u:P@1/2@10.0.0.5:554/s?a=b", "rtsp://u:P%401%2F2@10.0.0.5:554/s?a=b"),
        ("rtsp://u:p@x?y@10.0.0.5/s", "rtsp://u:p%40x%3Fy@10.0.0.5/s"),
        ("rtsp://u:a@b.c/d@cam.lan/s", "rtsp://u:a%40b.c%2Fd@cam.lan/s"),
        ("rtsp://u:a@b/c@cam/s", "rtsp://u:a%40b%2Fc@cam/s"),
        ("rtsp://u:12345/6@10.0.0.5/s", "rtsp://u:12345%2F6@10.0.0.5/s"),
        ("rtsp://me@home.org:p@w@nvr:8554/s", "rtsp://me%40home.org:p%40w@nvr:8554/s"),
        ("rtsp://10.0.0.5/s@1/x", "rtsp://10.0.0.5/s@1/x"),
        ("rtsp://host/stream@10.0.0.6/x", "rtsp://host/stream@10.0.0.6/x"),
        ("rtsp://u:p@10.0.0.5/s?mail=a@b.c/d", "rtsp://u:p@10.0.0.5/s?mail=a@b.c/d"),
        ("rtsp://u:p@[fe80::1%eth0]/s", "rtsp://u:p@[fe80::1%eth0]/s"),
        ("rtsp://host/stream", "rtsp://host/stream"),
        ("film.mp4", "film.mp4"),
    ],
)
def test_passwords_are_percent_encoded(url: str, encoded: str) -> None:
    assert percent_encoded(url) == encoded
