"""No password in any output."""

from __future__ import annotations

import io
import logging

import pytest

from camtopod import redact
from camtopod.cli.common import _Formatter
from camtopod.config import ConfigError, parse
from camtopod.redact import HIDDEN

SECRETS = ["secret", "p@ss:w/rd", "p%40ss%3Aw", "with space", "quote\"'<>", "ünïcode", "a://b@c", "#?&="]


@pytest.fixture(autouse=True)
def _forget(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(redact, "_known", set())


@pytest.mark.parametrize("password", SECRETS)
def test_a_remembered_password_is_hidden_wherever_it_stands(password: str) -> None:
    source = f"rtsp://admin:{password}@192.0.2.7:554/live"
    redact.remember(source)
    for text in (
        source,
        f"cannot open {source}: timeout",
        f"user admin:{password}@host",
        f"'{password}' is wrong",
    ):
        hidden = redact.redact(text)
        assert password not in hidden
        assert HIDDEN in hidden


@pytest.mark.parametrize("password", [secret for secret in SECRETS if " " not in secret])
def test_a_url_nobody_mentioned_before_is_hidden_too(password: str) -> None:
    text = redact.redact(f"warning: rtsp://admin:{password}@192.0.2.7/live stalled")
    assert password not in text
    assert "admin" not in text
    assert text.endswith("stalled")


def test_the_decoded_and_the_encoded_form_are_hidden() -> None:
    redact.remember("rtsp://u:p%40ssw%3Ard@h/")
    assert "p@ssw:rd" not in redact.redact("the server says p@ssw:rd is wrong")
    redact.remember("rtsp://u:x@yz:w@h/")
    assert "x%40yz%3Aw" not in redact.redact("opening with x%40yz%3Aw")


def test_parameters_are_hidden() -> None:
    text = redact.redact("rtsp://192.0.2.7/user=admin&password=hunter2&channel=1")
    assert "hunter2" not in text
    assert "channel=1" in text


def test_a_password_in_a_path_is_hidden() -> None:
    text = redact.redact("rtsp://192.0.2.7:554/user=admin_password=hunter2_channel=1_stream=0.sdp is slow")
    assert "hunter2" not in text
    assert text.endswith("is slow")


def test_other_text_is_left_alone() -> None:
    for text in ("rtsp://192.0.2.7:554/live stalled", "a@b", "camera lobby: 3 events", ""):
        assert redact.redact(text) == text


@pytest.mark.parametrize("form", ["text", "logfmt", "json"])
def test_logs_are_redacted(form: str) -> None:
    stream = io.StringIO()
    handler = logging.StreamHandler(stream)
    handler.setFormatter(_Formatter(form))
    logger = logging.Logger("camtopod.test")
    logger.addHandler(handler)
    logger.warning("cannot open %s", "rtsp://admin:p@ss:w/rd@host/x")
    try:
        raise ValueError("rtsp://admin:p@ss:w/rd@host/x")
    except ValueError:
        logger.exception("failed")
    assert "failed" in stream.getvalue()
    assert "p@ss" not in stream.getvalue()
    assert "w/rd" not in stream.getvalue()


def test_a_configuration_error_is_redacted() -> None:
    text = '[cameras.lobby]\nsource = "rtsp://admin:p@ss w/rd@host/x"\nspeed = "rtsp://admin:p@ss w/rd@host/x"\n'
    text += '[bus]\nconnect = ["bad/admin:p@ss w/rd@host"]\n'
    with pytest.raises(ConfigError) as caught:
        parse(text)
    assert "w/rd" not in str(caught.value)
    assert len(caught.value.problems) == 2
