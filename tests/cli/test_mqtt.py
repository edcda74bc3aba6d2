"""A real broker (mosquitto), with passwords, TLS and outages: Frigate's messages, and our own."""

from __future__ import annotations

import contextlib
import datetime
import ipaddress
import logging
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import frigate_messages as says
import pytest
from mosquitto import PROGRAM, mosquitto
from serving import T0, camtopod, wait_for

from camtopod import mqtt
from camtopod.cli import exits
from camtopod.cli.main import main

USER, PASSWORD = "camtopod", "hunter2-long"

pytest.importorskip("paho.mqtt.publish", reason="needs paho-mqtt (camtopod[mqtt])")
pytestmark = pytest.mark.skipif(
    PROGRAM is None, reason="needs the broker mosquitto (Debian: mosquitto)"
)


class Ingest:
    """`camtopod ingest frigate` in a process of its own, writing lines."""

    def __init__(self, tmp_path: Path, url: str, *options: str, **variables: str) -> None:
        self.out, self._err = tmp_path / "out.jsonl", tmp_path / "err.txt"
        command = [sys.executable, "-m", "camtopod", "ingest", "frigate", url]
        command += ["--out", str(self.out), *options]
        with self._err.open("wb") as err:
            self.process = subprocess.Popen(command, stderr=err, env={**os.environ, **variables})

    def __enter__(self) -> Ingest:
        wait_for(
            lambda: "subscribed to frigate/events" in self.said or self.process.poll() is not None,
            "the subscription",
        )
        assert self.process.poll() is None, self.said
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()

    @property
    def said(self) -> str:
        return self._err.read_text()

    def wait_for_lines(self, count: int) -> None:
        wait_for(
            lambda: self.out.exists() and self.out.read_bytes().count(b"\n") >= count,
            f"{count} lines",
        )


def test_events_come_while_objects_come_and_go_and_the_broker_may_be_away(tmp_path: Path) -> None:
    with (
        mosquitto(tmp_path) as broker,
        Ingest(tmp_path, f"mqtt://127.0.0.1:{broker.port}/frigate") as ingest,
    ):
        broker.publish(says.passage(1)[:2])
        ingest.wait_for_lines(1)
        broker.publish([*says.passage(1)[2:], b"nonsense"])
        ingest.wait_for_lines(2)
        broker.stop()
        wait_for(lambda: "lost 127.0.0.1" in ingest.said, "the loss to be noticed")
        assert broker.start()
        wait_for(
            lambda: ingest.said.count("subscribed to frigate/events") == 2,
            "the subscription after the loss",
        )
        broker.publish(says.passage(2, T0))
        ingest.wait_for_lines(4)
        ingest.process.send_signal(signal.SIGTERM)
        assert ingest.process.wait(20) == exits.FAILED, "fewer than nine of ten were accepted"
        assert "frigate/events:4: is neither a message nor a topic and a message" in ingest.said
        assert "1 of 7 lines were rejected: malformed 1" in ingest.said
        assert "Jane" not in ingest.out.read_text()


def test_a_password_from_a_file_or_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    users, secret = tmp_path / "users", tmp_path / "secret"
    users.touch(0o600)
    program = shutil.which("mosquitto_passwd")
    assert program is not None
    subprocess.run([program, "-b", str(users), USER, PASSWORD], check=True, capture_output=True)
    secret.write_text(f"{PASSWORD}\n")
    secret.chmod(0o600)
    with mosquitto(tmp_path, f"password_file {users}") as broker:
        url = f"mqtt://{USER}@127.0.0.1:{broker.port}/frigate"
        for options, variables in (
            (["--password-file", str(secret)], {}),
            ([], {"CAMTOPOD_MQTT_PASSWORD": PASSWORD}),
        ):
            with Ingest(tmp_path, url, *options, **variables) as ingest:
                broker.publish(says.passage(), auth={"username": USER, "password": PASSWORD})
                ingest.wait_for_lines(2)
                assert PASSWORD not in ingest.said
                ingest.out.unlink()
        secret.write_text("wrong-one")
        assert (
            main(["ingest", "frigate", url, "--password-file", str(secret), "--out", "-"])
            == exits.INPUT
        )
        monkeypatch.delenv("CAMTOPOD_MQTT_PASSWORD", raising=False)
        assert main(["ingest", "frigate", url, "--out", "-"]) == exits.INPUT
        err = capsys.readouterr().err
        assert err.count("refuses: Not authorized") == 2
        assert "wrong-one" not in err


def certificate(folder: Path) -> tuple[Path, Path]:
    """Write a self-signed certificate for 127.0.0.1, and its key."""
    x509 = pytest.importorskip("cryptography.x509", reason="needs cryptography (camtopod[keys])")
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "broker")])
    today = datetime.datetime.now(datetime.UTC)
    day = datetime.timedelta(days=1)
    address = x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))])
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(7)
        .not_valid_before(today - day)
        .not_valid_after(today + day)
        .add_extension(address, False)
        .add_extension(x509.BasicConstraints(True, None), True)
        .sign(key, hashes.SHA256())
    )
    cert_file, key_file = folder / "cert.pem", folder / "key.pem"
    cert_file.write_bytes(made.public_bytes(serialization.Encoding.PEM))
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    key_file.write_bytes(private)
    return cert_file, key_file


def test_tls(tmp_path: Path) -> None:
    cert, key = certificate(tmp_path)
    with mosquitto(tmp_path, f"certfile {cert}", f"keyfile {key}") as broker:
        url = f"mqtts://127.0.0.1:{broker.port}/frigate"
        with Ingest(tmp_path, url, "--ca", str(cert)) as ingest:
            broker.publish(says.passage(), tls={"ca_certs": str(cert)})
            ingest.wait_for_lines(2)
        for options, said in (
            ([], "certificate verify failed"),
            (["--ca", str(tmp_path / "none")], "No such file"),
        ):
            refused = camtopod("ingest", "frigate", url, "--out", "-", *options, stderr=-1)
            _, err = refused.communicate(timeout=60)
            assert refused.returncode == exits.INPUT
            assert said in err.decode()


def test_nobody_there_or_somebody_else(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(mqtt, "CONNECT_SECONDS", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        assert (
            main(["ingest", "frigate", f"mqtt://127.0.0.1:{port}/frigate", "--out", "-"])
            == exits.INPUT
        )
        assert "does not answer as an MQTT broker" in capsys.readouterr().err
    assert (
        main(["ingest", "frigate", f"mqtt://127.0.0.1:{port}/frigate", "--out", "-"]) == exits.INPUT
    )
    assert f"cannot reach 127.0.0.1:{port}" in capsys.readouterr().err


def test_bytes_that_wait_have_a_limit_and_prefixes_may_be_any(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(mqtt, "WAITING_BYTES_MAX", 1000)
    with mosquitto(tmp_path) as broker:
        source = mqtt.broker(f"mqtt://127.0.0.1:{broker.port}/frigate")
        with contextlib.closing(mqtt.MessageSubscription(source, "events")) as messages:
            broker.publish([b"x" * 400] * 5)
            wait_for(lambda: messages.dropped_count == 3, "the messages")
            stop = threading.Event()
            read = messages.read(stop)
            assert [len(next(read)) for _ in range(2)] == [400, 400]
            broker.publish([b"y" * 900])
            assert next(read) == b"y" * 900
            stop.set()
        anywhere = mqtt.broker(f"mqtt://127.0.0.1:{broker.port}/+")
        subscription = mqtt.MessageSubscription(anywhere, "#", with_topics=True)
        with contextlib.closing(subscription) as messages:
            broker.publish([b"z"])
            assert next(messages.read(threading.Event())) == b"frigate/events z"
    assert "3 messages of frigate/events were dropped" in caplog.text


def test_a_topic_that_is_not_utf_8_does_not_end_the_reading(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Not every broker refuses it, and an error here ends paho's thread without a word."""
    from paho.mqtt.client import Client, MQTTMessage
    from paho.mqtt.enums import CallbackAPIVersion

    monkeypatch.setattr(mqtt._BrokerConnection, "__init__", lambda *_: None)
    source = mqtt.broker("mqtt://127.0.0.1/+")
    messages = mqtt.MessageSubscription(source, "#", with_topics=True)
    client = Client(CallbackAPIVersion.VERSION2)
    for topic in (b"gate/\xff", b"gate/frame"):
        message = MQTTMessage(topic=topic)
        message.payload = b"{}"
        messages._on_message(client, None, message)
    assert next(messages.read(threading.Event(), ticks=True)) == b"gate/frame {}"
    assert next(messages.read(threading.Event(), ticks=True)) == b""


def test_retained_messages_are_not_read(tmp_path: Path) -> None:
    """They are of earlier, as is told when a subscription begins."""
    from paho.mqtt import publish

    with mosquitto(tmp_path) as broker:
        where = {"hostname": "127.0.0.1", "port": broker.port}
        publish.single("frigate/events", b"old", 1, True, **where)
        source = mqtt.broker(f"mqtt://127.0.0.1:{broker.port}/frigate")
        with contextlib.closing(mqtt.MessageSubscription(source, "events")) as messages:
            broker.publish([b"new"])
            assert next(messages.read(threading.Event())) == b"new"


def test_without_the_extra_it_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "paho"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "paho", None)
    assert main(["ingest", "frigate", "mqtt://127.0.0.1:1/frigate", "--out", "-"]) == exits.FAILED
    assert "pip install 'camtopod[mqtt]'" in capsys.readouterr().err


@pytest.mark.parametrize("may_write", [(), ("camtopod/#",), ("camtopod/#", "homeassistant/#")])
def test_a_bridge_that_may_not_write_says_so(
    may_write: tuple[str, ...], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rights = tmp_path / "acl"
    rights.write_text("".join(f"topic write {topic}\n" for topic in may_write))
    caplog.set_level(logging.INFO)
    with mosquitto(tmp_path, f"acl_file {rights}") as broker:
        at = mqtt.broker(f"mqtt://127.0.0.1:{broker.port}/camtopod")
        with contextlib.closing(mqtt.RetainedMessages(at, "camtopod/bridge")) as messages:
            messages.show({"homeassistant/a": "1", "camtopod/a": "2"})
        # The end waits for the answer to the last message, so those before it are there.
    refusals = [line for line in caplog.messages if "refuses messages (Not authorized)" in line]
    assert len(refusals) == (3, 1, 0)[len(may_write)]
    assert all("must be allowed to write below camtopod" in line for line in refusals)
