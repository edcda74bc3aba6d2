"""What FFmpeg says on standard output is heard while it is listened to, and nothing of that stays behind."""

from __future__ import annotations

import os

import pytest

from camtopod.vision.complaints import LEVEL_VARIABLE, LEVEL_WARNINGS, listening


def said(text: str) -> None:
    os.write(1, text.encode())


def test_a_reason_is_heard_and_standard_output_is_itself_again(capfd: pytest.CaptureFixture[str]) -> None:
    with listening() as complaints:
        said("[rtsp] method DESCRIBE failed: 401 Unauthorized\n")
        assert "user name or password" in complaints.take()
    said("data\n")
    assert capfd.readouterr().out == "data\n"


@pytest.mark.parametrize("before", [None, "16"])
def test_what_programs_started_later_say_is_as_before(before: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """They may have data for their standard output, which FFmpeg would print its warnings among."""
    monkeypatch.delenv(LEVEL_VARIABLE, raising=False)
    if before is not None:
        monkeypatch.setenv(LEVEL_VARIABLE, before)
    with listening():
        assert os.environ[LEVEL_VARIABLE] == (before or LEVEL_WARNINGS)
    assert os.environ.get(LEVEL_VARIABLE) == before
