"""What FFmpeg says on standard output is heard while it is listened to."""

from __future__ import annotations

import os

import pytest

from camtopod.vision.complaints import listening


def said(text: str) -> None:
    os.write(1, text.encode())


def test_a_reason_is_heard_and_standard_output_is_itself_again(capfd: pytest.CaptureFixture[str]) -> None:
    with listening() as complaints:
        said("[rtsp] method DESCRIBE failed: 401 Unauthorized\n")
        assert "user name or password" in complaints.take()
    said("data\n")
    assert capfd.readouterr().out == "data\n"
