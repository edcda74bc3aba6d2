"""No output has a password in it."""

from __future__ import annotations

import itertools
import time

import pytest

from camtopod import redact
from camtopod.config.config_file import parse
from camtopod.config.settings import ConfigError
from camtopod.redact import HIDDEN

SECRETS = [
    "secret",
    "p@ss:w/rd",
    "p%40ss%3Aw",
    "with space",
    "quote\"'<>",
    "ünïcode",
    "a://b@c",
    "#?&=",
]


@pytest.fixture(autouse=True)
def _forget(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(redact, "_secrets", set())


@pytest.mark.parametrize("password", SECRETS)
def test_a_password_is_hidden_in_a_url_and_once_remembered_wherever_it_stands(
    password: str,
) -> None:
    source = f"rtsp://admin:{password}@192.0.2.7:554/live"
    if " " not in password:
        hidden = redact.redact(f"warning: {source} stalled")
        assert password not in hidden
        assert "admin" not in hidden
        assert hidden.endswith("stalled")
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


TOKENS = (
    "3f9c8a7be1d24c5d",
    "3f9c8a7b-e1d2-4c5d-9a7b-e1d24c5d8a7b",
    "JHeOzLkM0NvTzhGq",
    "xoYb2-Kq9_vT4sWn8LrE1mZc6HdU3jGf5pAiBt7QyX",
    "k3j9x0q2m8v7c1z5w4t6",
    "eyJhbGciOiJIUzI1NiJ9.eyJzdWIiOiI0MiJ9.kP2mYx9sTq4LwVbN7rEz",
    "abCD12%2Fef34GH%3Dij",
)


@pytest.mark.parametrize("token", TOKENS)
@pytest.mark.parametrize(
    "url",
    [
        "rtsp://192.0.2.7:554/stream/{}/live",
        "rtsps://nvr:7441/{}?enableSrtp",
        "https://h/api/{}",
        "https://h/?k={}",
    ],
)
def test_a_token_in_a_path_is_hidden(token: str, url: str) -> None:
    source = url.format(token)
    for text in (f"cannot open {source}: timeout", f"'{source}'", f'{{"source":"{source}"}}'):
        hidden = redact.redact(text)
        assert not [part for part in token.split(".") if part in hidden]
        assert hidden.replace(HIDDEN, "").startswith(text.partition(token)[0])
    assert redact.holds_secret(source)
    redact.remember(source.replace("://", "://admin@"))
    assert redact.redact(f"DESCRIBE /stream/{token}/live fails") == (
        f"DESCRIBE /stream/{'.'.join([HIDDEN] * len(token.split('.')))}/live fails"
    )


@pytest.mark.parametrize(
    "path",
    [
        "Streaming/Channels/101",
        "cam/realmonitor?channel=1&subtype=0",
        "h264Preview_01_main",
        "axis-media/media.amp",
        "MediaInput/h264/stream_1",
        "live_h264_1280x720_15fps",
        "MEDIA_PROFILE_CHANNEL_1_STREAM_2",
        "building-7_floor_12_corridor_north",
        "VideoSourceToken_1",
        "DS-2CD2143G0-I20190101AAWRC12345678",
        "ACCC8E123456",
        "AC-CC-8E-12-34-56/live",
        "1700000000123456789",
        "camtopo/site/topology?version=7",
    ],
)
def test_an_ordinary_path_is_left_alone(path: str) -> None:
    url = f"rtsp://a1b2c3d4e5f6a7b8c9d0.cameras.example.org:554/{path}"
    redact.remember(url)
    assert redact.redact(f"cannot open {url}: timeout") == f"cannot open {url}: timeout"
    assert not redact.holds_secret(url)


def test_what_looks_like_a_token_outside_of_a_url_is_left_alone() -> None:
    for text in (
        "version 01HZX3K9QWERTY7ABCDEF01234 has digest 3f9c8a7be1d24c5d3f9c8a7be1d24c5d",
        "/var/lib/camtopod/3f9c8a7be1d24c5d3f9c8a7be1d24c5d/journal.db",
        "file:///videos/3f9c8a7be1d24c5d3f9c8a7be1d24c5d.mp4",
        '{"at":"rtsp://h/live","digest":"3f9c8a7be1d24c5d3f9c8a7be1d24c5d"}',
    ):
        assert redact.redact(text) == text


def test_text_that_somebody_made_to_take_long_does_not() -> None:
    pieces = ("a", "_", "a://", "a://x", "private_key", "x://h/a1", "a1", "@", "user", "a.1-")
    for piece, end in itertools.product(pieces, ("", " ", "@", "=")):
        text = piece * (20_000 // len(piece)) + end
        began = time.process_time()
        redact.redact(text)
        assert time.process_time() - began < 1.0, (piece, end)


def test_a_configuration_error_is_redacted() -> None:
    text = '[cameras.lobby]\nsource = "rtsp://admin:p@ss w/rd@host/x"\npage = "rtsp://admin:p@ss w/rd@host/x"\n'
    text += '[bus]\nconnect = ["bad/admin:p@ss w/rd@host"]\n'
    with pytest.raises(ConfigError) as caught:
        parse(text)
    assert "w/rd" not in str(caught.value)
    assert len(caught.value.problems) == 2


def test_a_password_that_is_a_word_is_not_hidden_within_other_words() -> None:
    redact.remember("rtsp://viewer:secret@192.0.2.1/")
    said = "URLs with secrets are in the folder secrets; rtsp://viewer:secret@192.0.2.1/ (secret)"
    assert redact.redact(said) == (
        "URLs with secrets are in the folder secrets; rtsp://***@192.0.2.1/ (***)"
    )
