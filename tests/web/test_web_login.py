"""Login of the page: password, sessions, token, and how often one may guess."""

from __future__ import annotations

import contextlib
import http.client
import json
from collections.abc import Iterator
from pathlib import Path
from typing import cast
from urllib.parse import quote, urlsplit

import pytest
from chromium import Browser
from fake_bus import OneBus
from page_fixture import Shown
from synthetic_topology import synthetic_topology

from camtopod.cli.commands import web
from camtopod.cli.commands.web import listening, names
from camtopod.cli.exits import CommandError, InputError
from camtopod.config.settings import Config, WebSettings
from camtopod.serve.bus.session import Bus
from camtopod.web import app, login
from camtopod.web.login import Login, LoginRefused

PASSWORD, TOKEN = "correct horse", "a-token-of-enough-characters"
PRIVATE = (
    "/data/map",
    "/data/health",
    "/data/pictures",
    "/picture/a",
    "/live",
    "/api/topology",
    "/static/main.js",
    "/nowhere",
)


class Steady:
    """A clock that is set by hand."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


class Client:
    """HTTP requests to a page that asks for the password."""

    def __init__(self, port: int, steady: Steady) -> None:
        self.port, self.steady = port, steady

    def ask(
        self, method: str, path: str, body: str = "", **headers: str
    ) -> tuple[int, dict[str, str], str]:
        """Return status, headers and content of an answer."""
        with contextlib.closing(http.client.HTTPConnection("127.0.0.1", self.port)) as connection:
            given = {name.replace("_", "-"): value for name, value in headers.items()}
            connection.request(method, path, body or None, given)
            answer = connection.getresponse()
            return (
                answer.status,
                {k.lower(): v for k, v in answer.getheaders()},
                answer.read().decode(),
            )

    def log_in(self, password: str, **headers: str) -> tuple[int, dict[str, str], str]:
        return self.ask("POST", "/login", f"password={quote(password)}", **headers)

    def session(self) -> str:
        """Log in and return the cookie."""
        return self.log_in(PASSWORD)[1]["set-cookie"].partition(";")[0]


@pytest.fixture
def client() -> Iterator[Client]:
    steady = Steady()
    with (
        listening("127.0.0.1", 0) as listener,
        app.serving(
            cast(Bus, OneBus()),
            listener,
            names("127.0.0.1"),
            None,
            lambda: 1000.0,
            1.0,
            login=Login(PASSWORD, TOKEN, steady),
        ),
    ):
        yield Client(listener.getsockname()[1], steady)


@pytest.mark.parametrize("path", PRIVATE)
def test_nothing_is_answered_without_a_login(client: Client, path: str) -> None:
    status, headers, content = client.ask("GET", path)
    assert (status, headers["www-authenticate"]) == (401, "Bearer")
    assert json.loads(content) == {"error": "this needs a login or a token"}


def test_the_page_leads_to_the_login_and_a_login_to_the_page(client: Client) -> None:
    assert client.ask("GET", "/")[:2][0] == 303
    assert client.ask("GET", "/")[1]["location"] == "login"
    status, headers, content = client.ask("GET", "/login")
    assert status == 200
    assert content.count("<input") - content.count("hidden") == 1, "one field"
    assert "form-action 'self'" in headers["content-security-policy"]
    assert "script-src" not in headers["content-security-policy"]
    status, headers, _ = client.log_in(PASSWORD)
    assert (status, headers["location"]) == (303, "./")
    cookie = headers["set-cookie"].partition(";")[0]
    assert client.ask("GET", "/", cookie=cookie)[0] == 200
    assert client.ask("GET", "/data/map", cookie=cookie)[0] == 200
    assert client.ask("GET", "/login", cookie=cookie)[0] == 303
    assert json.loads(client.ask("GET", "/data/health", cookie=cookie)[2])["login"] is True


def test_the_cookie_is_for_this_server_alone_and_no_script(client: Client) -> None:
    one, other = (client.log_in(PASSWORD)[1]["set-cookie"] for _ in range(2))
    assert one.startswith(f"camtopod_session_{client.port}=")
    assert {"httponly", "samesite=strict", "path=/", "max-age=604800"} <= {
        part.strip().lower() for part in one.split(";")
    }
    assert "secure" not in one.lower()
    assert one.partition(";")[0] != other.partition(";")[0], "a session has a name of its own"
    behind_https = client.log_in(PASSWORD, x_forwarded_proto="https")[1]["set-cookie"]
    assert "secure" in behind_https.lower()


def test_a_session_ends(client: Client) -> None:
    early, late = client.session(), client.session()
    assert client.ask("POST", "/logout", cookie=early)[0] == 200
    assert client.ask("GET", "/data/map", cookie=early)[0] == 401
    client.steady.now = login.SESSION_SECONDS - 1.0
    assert client.ask("GET", "/data/map", cookie=late)[0] == 200
    client.steady.now += 2.0
    assert client.ask("GET", "/data/map", cookie=late)[0] == 401


@pytest.mark.parametrize("wrong", ["", "correct hors", PASSWORD + " ", "\udc80", "x" * 3000])
def test_a_wrong_password_opens_nothing(client: Client, wrong: str) -> None:
    status, headers, content = client.ask(
        "POST", "/login", f"password={quote(wrong, errors='surrogateescape')}"
    )
    assert status == 403
    assert "set-cookie" not in headers
    assert login.WRONG in content


@pytest.mark.parametrize("body", ["", "user=me", "password", "p" * (login.FORM_BYTES_MAX + 1)])
def test_a_form_without_a_password_is_a_wrong_one(client: Client, body: str) -> None:
    status, headers, _ = client.ask("POST", "/login", body)
    assert status in (403, 413)
    assert "set-cookie" not in headers


def test_guesses_are_limited_even_the_right_one(client: Client) -> None:
    for _ in range(login.TRIES_MAX):
        assert client.log_in("wrong")[0] == 403
    status, _, content = client.log_in(PASSWORD)
    assert status == 429
    assert login.TOO_MANY in content
    client.steady.now += login.TRIES_SECONDS
    assert client.log_in(PASSWORD)[0] == 303


@pytest.mark.parametrize(
    ("given", "status"),
    [
        (f"Bearer {TOKEN}", 200),
        (f"bearer {TOKEN}", 200),
        (f"Bearer {TOKEN}x", 401),
        (f"Bearer {PASSWORD}", 401),
        ("Bearer", 401),
        (f"Basic {TOKEN}", 401),
    ],
)
def test_programs_give_the_token(client: Client, given: str, status: int) -> None:
    assert client.ask("GET", "/data/map", authorization=given)[0] == status


def test_addresses_are_limited_each_by_itself() -> None:
    one = Login(PASSWORD, steady=Steady())
    for _ in range(login.TRIES_MAX):
        with pytest.raises(LoginRefused, match="not the password"):
            one.open_session("wrong", "192.0.2.1")
    with pytest.raises(LoginRefused, match="Too many"):
        one.open_session(PASSWORD, "192.0.2.1")
    assert one.open_session(PASSWORD, "192.0.2.2")


def test_what_is_remembered_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(login, "SESSIONS_MAX", 3)
    monkeypatch.setattr(login, "ADDRESSES_MAX", 3)
    one = Login(PASSWORD, steady=Steady())
    for k in range(9):
        one.open_session(PASSWORD, "192.0.2.1")
        with pytest.raises(LoginRefused):
            one.open_session("wrong", f"192.0.2.{k}")
    assert len(one._sessions) == len(one._wrong) == 3


# --- the configuration
# -----------------------------------------------------------------------------------


def secret(path: Path, text: str, mode: int = 0o600) -> str:
    path.write_text(text)
    path.chmod(mode)
    return str(path)


def test_password_and_token_are_read_from_files(tmp_path: Path) -> None:
    files = secret(tmp_path / "p", PASSWORD + "\n"), secret(tmp_path / "t", TOKEN + "\n")
    assert web._login(Config()) is None
    made = web._login(Config(web=WebSettings(*files)))
    assert made is not None
    assert made.open_session(PASSWORD, "")


@pytest.mark.parametrize(
    ("password", "token", "mode", "said"),
    [
        ("short", TOKEN, 0o600, "the password has fewer than 8 characters"),
        (PASSWORD, "short", 0o600, "the token has fewer than 20 characters"),
        (PASSWORD, TOKEN, 0o644, "can be read by others"),
        ("\n", TOKEN, 0o600, "has an empty first line"),
    ],
)
def test_a_bad_secret_is_an_error(
    tmp_path: Path, password: str, token: str, mode: int, said: str
) -> None:
    files = secret(tmp_path / "p", password, mode), secret(tmp_path / "t", token, mode)
    with pytest.raises((CommandError, InputError), match=said):
        web._login(Config(web=WebSettings(*files)))


# --- in a browser
# -----------------------------------------------------------------------------------


def test_a_person_logs_in_and_out(browser: Browser) -> None:
    shown = Shown(synthetic_topology(4), login=Login(PASSWORD))
    with shown.serving():
        shown.status()
        browser.open(shown.address)
        browser.wait(lambda: urlsplit(browser.address).path == "/login", "the login")
        browser.press(*"wrong", "ENTER")  # the field has the focus
        browser.wait(lambda: login.WRONG in browser.text("[role=alert]"), "that it is wrong")
        browser.press(*PASSWORD, "ENTER")
        browser.wait(lambda: browser.text("#live").startswith("live"), "the page to be live")
        browser.go("#/health")
        browser.wait(lambda: browser.text(".title button") == "Log out", "the button")
        browser.run("document.querySelector('.title button').click()")
        browser.wait(lambda: urlsplit(browser.address).path == "/login", "the login again")
    refused = [text for text in browser.complaints() if "403" not in text]
    assert refused == []


def test_an_open_page_whose_session_has_ended_leads_to_the_login(browser: Browser) -> None:
    steady = Steady()
    shown = Shown(synthetic_topology(4), login=Login(PASSWORD, steady=steady))
    with shown.serving():
        shown.status()
        browser.open(shown.address)
        browser.press(*PASSWORD, "ENTER")
        browser.wait(lambda: browser.text("#live").startswith("live"), "the page to be live")
        steady.now += login.SESSION_SECONDS + 1.0
        browser.go("#/health")  # which asks the server
        browser.wait(lambda: urlsplit(browser.address).path == "/login", "the login")
