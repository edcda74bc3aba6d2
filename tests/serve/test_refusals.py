"""zenoh's log about refused messages and sessions."""

from __future__ import annotations

import logging
import os

import pytest

from camtopod.serve.bus import refusals as module
from camtopod.serve.bus.refusals import LINE_BYTES_MAX, Refusals, capture_standard_output

STAMP = (
    "\x1b[2m2026-11-21T19:07:34.914831Z\x1b[0m \x1b[35mTRACE\x1b[0m rx-1 ThreadId({}) "
    "\x1b[1mdemux\x1b[0m\x1b[1m{{\x1b[0m\x1b[3mzid\x1b[0m\x1b[2m=\x1b[0med5ebe4e7facce829ba7735b7eff4892 "
    "\x1b[3msrc\x1b[0m\x1b[2m=\x1b[0msouth:0:client/a7fa79:1\x1b[1m}}\x1b[0m\x1b[2m:\x1b[0m "
    "\x1b[2mzenoh::net::routing::interceptor"
)
SUBJECT = "a7fa79 on Interface(lo)+CertCommonName(lobby)+Transport(Tls)+a7fa79"


def allowed(thread: int, direction: str = "ingress", key: str = "event/lobby") -> str:
    who = f"{STAMP.format(thread)}::access_control\x1b[0m\x1b[2m:\x1b[0m {SUBJECT}"
    return f"{who} is authorized to Put ({direction}) on camtopo/hq/{key}"


def denied(thread: int, direction: str = "ingress") -> str:
    who = f"{STAMP.format(thread)}::access_control\x1b[0m\x1b[2m:\x1b[0m {SUBJECT}"
    return f"{who} is unauthorized to Put ({direction}) on camtopo/hq/event/hall"


def over_limit(thread: int, priority: str = "Background") -> str:
    return (
        f"{STAMP.format(thread)}::qos_overwrite\x1b[0m\x1b[2m:\x1b[0m "
        f"Overwriting QoS for Put to QoS {{ priority: {priority}, congestion: Block, express: false }}"
    )


def dropped(thread: int) -> str:
    return f"{STAMP.format(thread)}\x1b[0m\x1b[2m:\x1b[0m Msg intercepted!"


def test_what_is_not_allowed_is_counted_and_said_once(caplog: pytest.LogCaptureFixture) -> None:
    refusals = Refusals()
    for _ in range(5):
        for line in (allowed(16), denied(16), dropped(16), allowed(16)):
            refusals.read_line(line)
    assert refusals.counts == {"denied": 5}
    with caplog.at_level(logging.INFO):
        refusals.read_line(denied(17))
    assert (
        caplog.text.count("the certificate of lobby does not allow Put on camtopo/hq/event/hall")
        == 1
    )


def test_what_is_over_a_limit_and_dropped_is_too_large(caplog: pytest.LogCaptureFixture) -> None:
    refusals = Refusals()
    for line in (allowed(16), over_limit(16), denied(17), dropped(16), dropped(17)):
        refusals.read_line(line)
    assert refusals.counts == {"denied": 1, "too-large": 1}
    said = "a put from lobby on camtopo/hq/event/lobby was dropped at 2026-11-21T19:07:34Z: it has more than 16384 bytes"
    assert said in caplog.text


@pytest.mark.parametrize(
    ("priority", "expected"),
    [
        ("Background", "a put from tcp/192.0.2.7:4711 on event/* was dropped"),
        ("DataLow", "a put from tcp/192.0.2.7:4711 on status/* was dropped"),
        ("DataHigh", "a query from tcp/192.0.2.7:4711 on ** was dropped"),
    ],
)
def test_without_certificates_it_is_said_from_where_and_over_which_limit(
    priority: str, expected: str, caplog: pytest.LogCaptureFixture
) -> None:
    refusals = Refusals()
    refusals.on_session("b037bdf0", None, "tcp/192.0.2.9:4711")
    refusals.on_session("a7fa790031fb2b3f6fa1bb9e2a7ba4f", None, "tcp/192.0.2.7:4711")
    refusals.read_line(over_limit(16, priority))
    refusals.read_line(dropped(16))
    assert refusals.counts == {"too-large": 1}
    assert expected in caplog.text


def test_a_question_that_is_not_answered_in_time_is_no_message_too_large(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Its session reports it without a key; nothing else is logged."""
    refusals = Refusals()
    for line in (dropped(18), allowed(18), over_limit(16), dropped(18), dropped(16), dropped(16)):
        refusals.read_line(line)
    assert refusals.counts == {"too-large": 1}


def test_what_may_not_go_out_to_somebody_is_nothing_to_count() -> None:
    refusals = Refusals()
    for line in (allowed(16), denied(16, "egress"), dropped(16)):
        refusals.read_line(line)
    assert refusals.counts == {}


ACTIONS = (
    "Query",
    "Reply",
    "Put",
    "Delete",
    "Declare/Undeclare Subscriber",
    "Declare/Undeclare Queryable",
    "Declare/Undeclare Liveliness Token",
    "Liveliness Query",
    "Declare Liveliness Subscriber",
)


def declares(refusals: Refusals, key: str, allowed_are: str) -> None:
    """Return zenoh's log of a session that declares a key, and whether each message is allowed."""
    control = f"{STAMP.format(16)}::access_control:"
    for way in ("ingress", "egress"):
        refusals.read_line(f"{control} ACL ({way}): caching permissions for `{key}` ...")
        for action in ACTIONS:
            allowed = "authorized" if action == allowed_are else "unauthorized"
            refusals.read_line(f"{control} {SUBJECT} is {allowed} to {action} ({way}) on {key}")


def test_what_would_not_be_allowed_is_no_refusal_until_it_comes(
    caplog: pytest.LogCaptureFixture,
) -> None:
    refusals = Refusals()
    control = f"{STAMP.format(16)}::access_control:"
    declares(refusals, "camtopo/hq/status/lobby", "Put")
    refusals.read_line(
        f"{control} Using cached result: a7fa79 is authorized to Put (ingress) on camtopo/hq/status/lobby"
    )
    assert refusals.counts == {}
    declares(refusals, "camtopo/hq/event/hall", "none")
    for _ in range(3):
        refusals.read_line(
            f"{control} Using cached result: a7fa79 is unauthorized to Put (ingress) on camtopo/hq/event/hall"
        )
        refusals.read_line(dropped(16))
    assert refusals.counts == {"denied": 3}
    assert "the certificate of lobby does not allow Put on camtopo/hq/event/hall" in caplog.text
    refusals.read_line(over_limit(16))
    refusals.read_line(dropped(16))
    assert refusals.counts == {"denied": 3, "too-large": 1}


def test_names_are_not_remembered_without_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "NAMES_MAX", 10)
    refusals = Refusals()
    for number in range(100):
        refusals.read_line(denied(16).replace("a7fa79", f"{number:x}"))
        refusals.on_session(f"a{number:x}", None, "tcp/192.0.2.7:4711")
    assert refusals.counts == {"denied": 100}
    assert len(refusals._names) <= 10


def test_handshakes_by_reason_and_the_rest_as_it_is(caplog: pytest.LogCaptureFixture) -> None:
    refusals = Refusals()
    with caplog.at_level(logging.INFO):
        refusals.read_line("WARN zenoh_link_tls::unicast: peer sent no certificates. Hint: none")
        refusals.read_line("WARN zenoh_link_tls::unicast: invalid peer certificate: UnknownIssuer")
        refusals.read_line("something else")
        refusals.read_line("")
    assert refusals.counts == {"no-certificate": 1, "wrong-authority": 1}
    assert "zenoh: something else" in caplog.text


def test_of_what_is_received_only_what_is_too_large_is_heard(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    refusals = Refusals()
    monkeypatch.setattr(module, "refusals", refusals)
    receiver = "\x1b[35mTRACE\x1b[0m rx-0 \x1b[2mzenoh_transport::unicast::universal::rx\x1b[0m"
    long = "120, " * LINE_BYTES_MAX
    with caplog.at_level(logging.INFO), capture_standard_output():
        os.write(
            1,
            f"{receiver}: Received: Frame {{ payload: [{long}] }}\nWARN something else\n".encode(),
        )
        os.write(
            1,
            f"{receiver}: Defragmentation buffer full: 1523494 bytes. Capacity: 1500000. at src\n".encode(),
        )
        os.write(1, f"{receiver}: First fragment received without start marker.\n".encode())
    assert refusals.counts == {"too-large": 1}
    assert "a message of more than 1523494 bytes was dropped: the bus takes 1500000" in caplog.text
    assert [message for message in caplog.messages if message.startswith("zenoh:")] == [
        "zenoh: WARN something else"
    ]
