"""How `camtopod init` logs in to ONVIF cameras: digests, clocks, and what is said of a refusal."""

from __future__ import annotations

import secrets
from typing import Any

import pytest
from onvif_camera import USER, OnvifCamera, onvif_camera

from camtopod.cli.cameras import onvif
from camtopod.cli.cameras.http_digest import Challenge, challenges

LOGIN = f"{USER}:p%40ss%2Fw%20ord@"
MD5 = 'Digest realm="cameras, all of \\"them\\"", qop="auth", nonce="NONCE", opaque="o p"'
SHA = 'Digest qop="auth-int, auth", algorithm=SHA-256, nonce="NONCE", realm="yard"'


def serving(**options: Any) -> Any:
    return onvif_camera([("main", 640, 360, 10)], {"main": "rtsp://127.0.0.1/1"}, **options)


def ask(camera: OnvifCamera, login: str = LOGIN) -> list[str]:
    return [stream.url for stream in onvif.streams(f"onvif://{login}{camera.address}")]


# --- digests --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "headers",
    [
        (MD5,),
        (SHA,),
        ('digest nonce="NONCE", realm=""',),
        ('Digest nonce="NONCE", realm="r", qop="auth", algorithm=MD5-sess',),
        ('Digest nonce="NONCE", realm="r", algorithm=SHA-256-sess',),
        ("Negotiate", f'Basic realm="x, y", {MD5}'),
    ],
)
def test_a_digest_is_answered(headers: tuple[str, ...]) -> None:
    with serving(challenges=headers) as camera:
        assert ask(camera) == [f"rtsp://{LOGIN}127.0.0.1/1"]
    assert camera.logins == ["token", "Digest", "Digest", "Digest"], "at once after the first"


def test_the_strongest_digest_is_taken() -> None:
    offers = challenges(
        [MD5, f'Digest realm="x", nonce="n", algorithm=SHA-512-256, {SHA}', "Basic"]
    )
    assert [offer.name for offer in offers] == [
        "Digest SHA-256 auth-int, auth",
        "Digest auth",
        "Digest SHA-512-256",
        "Basic",
    ]
    assert [offer.strength for offer in offers] == [1, 0, -1, -1]


@pytest.mark.parametrize(
    ("algorithm", "response"),
    [
        ("MD5", "8ca523f5e9506fed4657c9700eebdbec"),
        ("SHA-256", "753927fa0e85d155564e2e272a28d1802ca10daf4496794697cf8db5856cb6c1"),
    ],
)
def test_digests_are_those_of_the_standard(
    algorithm: str, response: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """RFC 7616, section 3.9.1."""
    client_nonce = "f2/wE4q74E6zIJEtWaHKaf5wv/H5QzzpXusqGemxURZJ"
    monkeypatch.setattr(secrets, "token_hex", lambda _: client_nonce)
    challenge = Challenge(
        "Digest",
        "http-auth@example.org",
        "7ypf/xlj9XXwfDPEoM4URrv/xwf94BcCAzFZH4GiTo0v",
        algorithm,
        "FQhe/qaU925kfnzjCev0ciny7QMkPqMAFRtzCUYo5tdS",
        "auth, auth-int",
    )
    header = challenge.authorization("Mufasa", "Circle of Life", "GET", "/dir/index.html")
    assert f'response="{response}"' in header
    assert "qop=auth, nc=00000001" in header
    assert f'opaque="{challenge.opaque}"' in header
    assert "nc=00000002" in challenge.authorization('"M"', "", "GET", "/")


@pytest.mark.parametrize("uses", [1, 2])
@pytest.mark.parametrize("stale", ["", ", stale=true"])
def test_a_nonce_may_grow_old(uses: int, stale: str) -> None:
    with serving(challenges=(MD5 + stale,), nonce_uses=uses) as camera:
        assert ask(camera) == [f"rtsp://{LOGIN}127.0.0.1/1"]


def test_a_nonce_that_is_stale_at_once_has_one_successor() -> None:
    with (
        serving(challenges=(MD5 + ", stale=TRUE",), nonce_uses=0) as camera,
        pytest.raises(onvif.OnvifError, match="refuses the user name or password"),
    ):
        ask(camera)
    assert camera.logins == ["token", "Digest", "Digest"]


def test_a_wrong_password_is_not_sent_again_and_again() -> None:
    with (
        serving(challenges=(MD5, SHA)) as camera,
        pytest.raises(onvif.OnvifError, match="refuses the user name or password"),
    ):
        ask(camera, f"{USER}:wrong@")
    assert camera.logins == ["token", "Digest"]


@pytest.mark.parametrize(
    ("header", "name"),
    [
        ('Basic realm="cam"', "Basic"),
        ('Digest realm="c", nonce="n", algorithm="SHA-512-256"', "Digest SHA-512-256"),
        ('Digest realm="c", nonce="n", qop="auth-int"', "Digest auth-int"),
    ],
)
def test_a_login_that_is_not_offered_is_named(header: str, name: str) -> None:
    with serving(challenges=(header,)) as camera:
        with pytest.raises(onvif.OnvifError, match=f"a login by {name}, which this program"):
            ask(camera)
        assert camera.logins == ["token"]
        with pytest.raises(onvif.OnvifError, match="asks for a login: write onvif://USER"):
            ask(camera, "")


# --- clocks ---------------------------------------------------------------------------------------


def told(**figures: int) -> str:
    numbers = {"Year": 2024, "Month": 1, "Day": 1, "Hour": 0, "Minute": 0, "Second": 0, **figures}
    return f"<UTCDateTime>{''.join(f'<{n}>{v}</{n}>' for n, v in numbers.items())}</UTCDateTime>"


CLOCKS = {
    "refused": (401, ""),
    "a fault": (400, "<Subcode>NotAuthorized</Subcode>"),
    "unknown": (500, ""),
    "no XML": (200, "<"),
    "nothing": (200, ""),
    "no date": (200, "<UTCDateTime/>"),
    "February 30": (200, told(Month=2, Day=30)),
    "hour 24": (200, told(Hour=24)),
    "year 0": (200, told(Year=0)),
    "a huge year": (200, told(Year=10**30)),
}


@pytest.mark.parametrize("clock", CLOCKS)
@pytest.mark.parametrize("headers", [(), (SHA,)])
def test_where_a_camera_tells_no_time_the_own_clock_is_used(
    clock: str, headers: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(onvif, "wall", lambda: 1e9)
    with serving(challenges=headers, clock=CLOCKS[clock]) as camera:
        camera.time = "2001-09-09T01:46:40Z"
        assert ask(camera) == [f"rtsp://{LOGIN}127.0.0.1/1"]


def test_the_clock_may_be_why_a_login_is_refused() -> None:
    with serving(clock=(401, "")) as camera:
        with pytest.raises(onvif.OnvifError, match="wrong, or the camera's clock, which it does"):
            ask(camera)
        with pytest.raises(onvif.OnvifError, match="asks for a login"):
            ask(camera, "")
    assert camera.logins == ["token"]
