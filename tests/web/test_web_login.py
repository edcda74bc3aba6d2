"""Login of the page: password, cookie, token, and how often one may guess."""

from __future__ import annotations

import contextlib
import http.client
import json
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote, urlsplit

import pytest
from chromium import Browser
from page_fixture import Answer, Shown
from starlette.requests import Request
from synthetic_topology import synthetic_topology

from camtopod.cli.commands import web
from camtopod.cli.exits import CommandError
from camtopod.config.settings import Config, WebSettings
from camtopod.web import login
from camtopod.web.login import Login

PASSWORD = "correct horse"
TOKEN = "a-token-of-enough-characters"
PRIVATE = ("/data/map", "/picture/a", "/live", "/api/topology", "/static/main.js", "/nowhere")


class Client(Shown):
    """A page that asks for the password; time stands still unless it is moved."""

    def __init__(self) -> None:
        super().__init__(login=Login(PASSWORD, TOKEN, lambda: self.now))
        self.now = 1e9

    def log_in(self, password: str, **headers: str) -> Answer:
        """Return the answer to the login form."""
        given = quote(password, errors="surrogateescape")
        return self.ask("/login", "POST", f"password={given}", **headers)

    def cookie(self) -> str:
        """Log in and return the cookie."""
        return self.log_in(PASSWORD).headers["set-cookie"].partition(";")[0]


@pytest.fixture(scope="module")
def served() -> Iterator[Client]:
    client = Client()
    with client.serving():
        yield client


@pytest.fixture
def client(served: Client) -> Client:
    """Return the client in another minute, in which nobody has guessed yet."""
    served.now += 60.0
    return served


def test_nothing_is_answered_without_a_login(client: Client) -> None:
    for path in PRIVATE:
        answer = client.ask(path)
        assert (answer.status, answer.headers["www-authenticate"]) == (401, "Bearer")
        assert json.loads(answer.content) == {"error": "this needs a login or a token"}


def test_the_page_leads_to_the_login_and_a_login_to_the_page(client: Client) -> None:
    page, form = client.ask("/"), client.ask("/login")
    assert (page.status, page.headers["location"]) == (303, "login")
    assert form.status == 200
    assert form.text.count("<input") - form.text.count("hidden") == 1, "one field"
    assert "form-action 'self'" in form.headers["content-security-policy"]
    assert "script-src" not in form.headers["content-security-policy"]

    answer = client.log_in(PASSWORD)
    assert (answer.status, answer.headers["location"]) == (303, "./")

    cookie = answer.headers["set-cookie"].partition(";")[0]
    for path, status in (("/", 200), ("/data/map", 200)):
        assert client.ask(path, cookie=cookie).status == status
    assert json.loads(client.ask("/data/health", cookie=cookie).content)["login"] is True


def test_the_cookie_is_for_this_server_alone_and_no_script(client: Client) -> None:
    cookie = client.log_in(PASSWORD).headers["set-cookie"]
    behind_https = client.log_in(PASSWORD, x_forwarded_proto="https").headers["set-cookie"]

    parts = {part.strip().lower() for part in cookie.split(";")}
    assert cookie.startswith(f"camtopod_session_{client.port}=")
    assert {"httponly", "samesite=strict", "path=/", "max-age=604800"} <= parts
    assert "secure" not in parts
    assert "secure" in behind_https.lower()


def test_a_login_ends_and_its_end_cannot_be_moved(client: Client) -> None:
    cookie = client.cookie()
    name, _, value = cookie.partition("=")
    ends, _, signature = value.partition(".")

    client.now += login.SESSION_SECONDS - 1.0
    assert client.ask("/data/map", cookie=cookie).status == 200
    client.now += 2.0
    for other in (value, f"{int(ends) + 9}.{signature}", f"{ends}.", f"x.{signature}", "é", ""):
        given = f"{name}={other}".encode().decode("latin-1")
        assert client.ask("/data/map", cookie=given).status == 401, other


def test_a_wrong_password_opens_nothing(client: Client) -> None:
    for wrong in ("", "correct hors", PASSWORD + " ", "\udc80", "x" * 3000):
        answer = client.log_in(wrong)
        assert (answer.status, "set-cookie" in answer.headers) == (403, False)
        assert login.WRONG in answer.text


def test_guesses_are_limited_even_the_right_one(client: Client) -> None:
    for _ in range(login.TRIES_PER_MINUTE_MAX):
        assert client.log_in("wrong").status == 403
    refused = client.log_in(PASSWORD)
    elsewhere = [client.log_in(PASSWORD, x_forwarded_for=f"192.0.2.{k}") for k in range(3)]
    own = http.client.HTTPConnection("127.0.0.1", client.port, 20, ("127.0.0.2", 0))
    with contextlib.closing(own):
        own.request("POST", "/login", f"password={quote(PASSWORD)}")
        again = own.getresponse().status
    client.now += 60.0

    assert (refused.status, login.TOO_MANY in refused.text) == (429, True)
    assert [one.status for one in elsewhere] == [429] * 3, "anybody can write that header"
    assert again == 429, "a machine has many addresses to itself"
    assert client.log_in(PASSWORD).status == 303


@pytest.mark.parametrize(
    ("one", "other", "together"),
    [
        ("2001:db8:0:7::1", "2001:db8:0:7:f::2", True),
        ("2001:db8:0:7::1", "2001:db8:0:8::1", False),
        ("fe80::1%eth0", "fe80::2%eth1", True),
        ("192.0.2.1", "192.0.2.2", False),
        ("::1", "127.9.9.9", True),
    ],
)
def test_addresses_that_one_may_choose_from_count_together(
    one: str, other: str, together: bool
) -> None:
    counted = {
        login.guesser(Request({"type": "http", "client": (host, 1)})) for host in (one, other)
    }
    assert (len(counted) == 1) is together


def test_programs_give_the_token(client: Client) -> None:
    for given, status in (
        (f"bearer {TOKEN}", 200),
        (f"Bearer {TOKEN}x", 401),
        (f"Bearer {PASSWORD}", 401),
        ("Bearer", 401),
        (f"Basic {TOKEN}", 401),
    ):
        assert client.ask("/data/map", authorization=given).status == status, given


def secret(path: Path, text: str, mode: int = 0o600) -> str:
    """Write a file with a secret and return its path."""
    path.write_text(text)
    path.chmod(mode)
    return str(path)


@pytest.mark.parametrize(
    ("password", "token", "mode", "said"),
    [
        ("short", TOKEN, 0o600, "the password has fewer than 8 characters"),
        (PASSWORD, "short", 0o600, "the token has fewer than 20 characters"),
        (PASSWORD, TOKEN, 0o644, "can be read by others"),
        ("\n", TOKEN, 0o600, "has an empty first line"),
        (PASSWORD + "\n", TOKEN + "\n", 0o600, ""),
    ],
)
def test_password_and_token_are_read_from_files(
    tmp_path: Path, password: str, token: str, mode: int, said: str
) -> None:
    settings = WebSettings(
        password_file=secret(tmp_path / "p", password, mode),
        token_file=secret(tmp_path / "t", token, mode),
    )

    assert web._login(Config()) is None
    if not said:
        assert web._login(Config(web=settings)) is not None
        return
    with pytest.raises((CommandError, OSError), match=said):
        web._login(Config(web=settings))


def test_a_person_logs_in_and_out_and_an_ended_login_leads_to_it(browser: Browser) -> None:
    shown = Shown(synthetic_topology(4), login=Login(PASSWORD))

    def wait_for_login() -> None:
        browser.wait(lambda: urlsplit(browser.address).path == "/login", "the login")

    def log_in() -> None:
        wait_for_login()
        browser.press(*PASSWORD, "ENTER")  # the field has the focus
        browser.wait(lambda: browser.text("#live").startswith("running"), "the page to be live")

    with shown.serving() as port:
        shown.status()
        browser.open(shown.address)
        wait_for_login()
        browser.press(*"wrong", "ENTER")
        browser.wait(lambda: login.WRONG in browser.text("[role=alert]"), "that it is wrong")
        log_in()
        browser.go("#/health")
        browser.wait(lambda: browser.text(".title button") == "Log out", "the button")
        browser.run("document.querySelector('.title button').click()")
        log_in()

    shown.login = Login(PASSWORD)  # which knows no login of before
    with shown.serving(port):
        wait_for_login()
    expected = ("403", "401", "net::ERR_")
    assert [text for text in browser.complaints() if not any(e in text for e in expected)] == []
