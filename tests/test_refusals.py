"""What zenoh's log says of who is refused."""

from __future__ import annotations

import logging
import os

import pytest

from camtopod.serve import refusals as module
from camtopod.serve.refusals import LINE_BYTES_MAX, Refusals, standard_output_heard

STAMP = (
    "\x1b[2m2026-11-21T19:07:34.914831Z\x1b[0m \x1b[35mTRACE\x1b[0m rx-1 ThreadId({}) zenoh::net::routing::interceptor"
)
SUBJECT = "a7fa79 on Interface(lo)+CertCommonName(lobby)+Transport(Tls)+a7fa79"


def allowed(thread: int, direction: str = "ingress") -> str:
    who = f"{STAMP.format(thread)}::access_control: {SUBJECT}"
    return f"{who} is authorized to Put ({direction}) on camtopo/hq/event/lobby"


def denied(thread: int, direction: str = "ingress") -> str:
    who = f"{STAMP.format(thread)}::access_control: {SUBJECT}"
    return f"{who} is unauthorized to Put ({direction}) on camtopo/hq/event/hall"


def dropped(thread: int) -> str:
    return f"{STAMP.format(thread)}: Msg intercepted!"


def test_what_is_not_allowed_is_counted_and_said_once(caplog: pytest.LogCaptureFixture) -> None:
    refusals = Refusals()
    for _ in range(5):
        for line in (allowed(16), denied(16), dropped(16), allowed(16)):
            refusals.hear(line)
    assert refusals.counts == {"denied": 5}
    with caplog.at_level(logging.INFO):
        refusals.hear(denied(17))
    assert caplog.text.count("the certificate of lobby does not allow Put on camtopo/hq/event/hall") == 1


def test_what_is_allowed_and_dropped_is_too_large() -> None:
    refusals = Refusals()
    for line in (allowed(16), denied(17), dropped(16), dropped(17), dropped(18)):
        refusals.hear(line)
    assert refusals.counts == {"denied": 1, "too-large": 2}


def test_what_may_not_go_out_to_somebody_is_nothing_to_count() -> None:
    refusals = Refusals()
    for line in (allowed(16), denied(16, "egress"), dropped(16)):
        refusals.hear(line)
    assert refusals.counts == {}


ACTIONS = (
    "Query", "Reply", "Put", "Delete", "Declare/Undeclare Subscriber", "Declare/Undeclare Queryable",
    "Declare/Undeclare Liveliness Token", "Liveliness Query", "Declare Liveliness Subscriber",
)  # fmt: skip


def declares(refusals: Refusals, key: str, allowed_are: str) -> None:
    """What zenoh says when a session declares a key: of each kind of message whether it would be allowed."""
    control = f"{STAMP.format(16)}::access_control:"
    for way in ("ingress", "egress"):
        refusals.hear(f"{control} ACL ({way}): caching permissions for `{key}` ...")
        for action in ACTIONS:
            allowed = "authorized" if action == allowed_are else "unauthorized"
            refusals.hear(f"{control} {SUBJECT} is {allowed} to {action} ({way}) on {key}")


def test_what_would_not_be_allowed_is_no_refusal_until_it_comes(caplog: pytest.LogCaptureFixture) -> None:
    refusals = Refusals()
    control = f"{STAMP.format(16)}::access_control:"
    declares(refusals, "camtopo/hq/status/lobby", "Put")
    refusals.hear(f"{control} Using cached result: a7fa79 is authorized to Put (ingress) on camtopo/hq/status/lobby")
    assert refusals.counts == {}
    declares(refusals, "camtopo/hq/event/hall", "none")
    for _ in range(3):
        refusals.hear(
            f"{control} Using cached result: a7fa79 is unauthorized to Put (ingress) on camtopo/hq/event/hall"
        )
        refusals.hear(dropped(16))
    assert refusals.counts == {"denied": 3}
    assert "the certificate of lobby does not allow Put on camtopo/hq/event/hall" in caplog.text
    refusals.hear(dropped(16))
    assert refusals.counts == {"denied": 3, "too-large": 1}


def test_names_are_not_remembered_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "NAMES_MAX", 10)
    refusals = Refusals()
    for number in range(100):
        refusals.hear(denied(16).replace("a7fa79", f"{number:x}"))
    assert refusals.counts == {"denied": 100}
    assert len(refusals._names) <= 10


def test_handshakes_by_reason_and_the_rest_as_it_is(caplog: pytest.LogCaptureFixture) -> None:
    refusals = Refusals()
    with caplog.at_level(logging.INFO):
        refusals.hear("WARN zenoh_link_tls::unicast: peer sent no certificates. Hint: none")
        refusals.hear("WARN zenoh_link_tls::unicast: invalid peer certificate: UnknownIssuer")
        refusals.hear("something else")
        refusals.hear("")
    assert refusals.counts == {"no-certificate": 1, "wrong-authority": 1}
    assert "zenoh: something else" in caplog.text


def test_of_what_is_received_only_what_is_too_large_is_heard(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    refusals = Refusals()
    monkeypatch.setattr(module, "refusals", refusals)
    receiver = "\x1b[35mTRACE\x1b[0m rx-0 \x1b[2mzenoh_transport::unicast::universal::rx\x1b[0m"
    long = "120, " * LINE_BYTES_MAX
    with caplog.at_level(logging.INFO), standard_output_heard():
        os.write(1, f"{receiver}: Received: Frame {{ payload: [{long}] }}\nWARN something else\n".encode())
        os.write(1, f"{receiver}: Defragmentation buffer full: 1523494 bytes. Capacity: 1500000. at src\n".encode())
        os.write(1, f"{receiver}: First fragment received without start marker.\n".encode())
    assert refusals.counts == {"too-large": 1}
    assert [message for message in caplog.messages if message.startswith("zenoh:")] == ["zenoh: WARN something else"]
