"""FFmpeg's output on standard output is captured while a block runs."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from camtopod.vision.source.ffmpeg_log import captured_log

PRINTS_AS_C_DOES = """
import ctypes, sys
from camtopod.vision.source.ffmpeg_log import captured_log

libc = ctypes.CDLL(None)
libc.printf(b"before\\n")
with captured_log() as ffmpeg_log:
    libc.printf(b"[tcp] Connection to tcp://127.0.0.1 failed: Connection refused\\n")
    print(ffmpeg_log.newest_reason(), file=sys.stderr)
    libc.printf(b"said when nobody asks any more\\n")
print("data")
"""


def write_as_ffmpeg(text: str) -> None:
    os.write(1, text.encode())


def test_a_reason_is_heard_and_standard_output_is_itself_again(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with captured_log() as ffmpeg_log:
        write_as_ffmpeg("[rtsp] method DESCRIBE failed: 401 Unauthorized\n")
        assert "user name or password" in ffmpeg_log.newest_reason()
    write_as_ffmpeg("data\n")
    assert capfd.readouterr().out == "data\n"


def test_what_waits_in_the_buffer_of_c_is_heard_too() -> None:
    """C buffers some kilobytes if standard output is no terminal, and OpenCV prints through it."""
    done = subprocess.run(
        [sys.executable, "-c", PRINTS_AS_C_DOES], capture_output=True, text=True, check=True
    )
    assert "nothing listens" in done.stderr
    assert done.stdout == "before\ndata\n"
