"""`camtopod doctor`: its findings, also with many faults, and that it prints no secret."""

from __future__ import annotations

import json
import stat
from pathlib import Path
from typing import NoReturn

import pytest
from serving import small_config, wait_for

from camtopod import redact
from camtopod.cli.commands import doctor
from camtopod.cli.main import main
from camtopod.config.settings import Config
from camtopod.serve.bus import BusError, dial
from camtopod.serve.daemon import Daemon

SECRETS = {
    "url": "p@ss:w/0rd",
    "quoted": 'in "quotes" and ünïcode\\n',
    "parameter": "Parameter77",
    "path": "InThePath88",
    "token": "3f9c8a7be1d24c5d9a7b",
    "file": "from-a-file-99",
    "credential": "from-systemd-11",
    "mqtt": "mosquitto-22",
    "mqtt's file": "mosquitto-in-a-file-66",
    "environment": "environment-33",
    "endpoint": "c2VjcmV0LWtleQ==",
    "status": "said-by-a-camera-44",
    "rejected": "in-an-event-55",
    "key": "MC4CAQAwBQYDK2VwBCIEI66",
}


@pytest.fixture(autouse=True)
def _alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(redact, "_secrets", set())
    for name in ("STATE_DIRECTORY", "CREDENTIALS_DIRECTORY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state-home"))


@pytest.fixture
def planted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write a configuration with a secret, or a path to one, in every possible place."""
    credentials = tmp_path / "credentials"
    credentials.mkdir()
    (credentials / "source").write_text(f"rtsp://admin:{SECRETS['credential']}@192.0.2.4/x\n")
    (credentials / "mqtt").write_text(SECRETS["mqtt's file"] + "\n")
    (credentials / "private.key").write_text(
        f"-----BEGIN PRIVATE KEY-----\n{SECRETS['key']}\n-----END PRIVATE KEY-----\n"
    )
    (tmp_path / "lobby").write_text(f"rtsp://admin:{SECRETS['file']}@192.0.2.5/x\n")
    (tmp_path / "lobby").chmod(
        0o644
    )  # as most files are; the umask of who runs the tests may be a stricter one
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(credentials))
    monkeypatch.setenv("CAMTOPOD_MQTT_PASSWORD", SECRETS["mqtt"])
    monkeypatch.setenv("CAMERA_URL", f"rtsp://u:{SECRETS['environment']}@h/x")
    sources = {
        "url": f"rtsp://admin:{SECRETS['url']}@192.0.2.1/x",
        "quoted": f"rtsp://admin:{SECRETS['quoted']}@192.0.2.2/x",
        "parameter": f"rtsp://192.0.2.3/x?user=admin&password={SECRETS['parameter']}&channel=1",
        "path": f"rtsp://192.0.2.3/user=admin_password={SECRETS['path']}_channel=1",
        "token": f"rtsp://192.0.2.3:7441/stream/{SECRETS['token']}/live",
    }
    text = f'# rtsp://old:{SECRETS["environment"]}@192.0.2.9/x\n[site]\nname = "hq"\n'
    text += "".join(
        f"[cameras.{name}]\nsource = {json.dumps(source, ensure_ascii=False)}\n"
        for name, source in sources.items()
    )
    text += f'[cameras.file]\nsource_file = "{tmp_path}/lobby"\n'
    text += '[cameras.credential]\nsource_file = "$CREDENTIALS_DIRECTORY/source"\n'
    path = tmp_path / "camtopod.toml"
    path.write_text(text)
    return path


def without_secrets(text: str) -> str:
    """Return the text, after checking that no secret is in it, in any quoted form."""
    for name, secret in SECRETS.items():
        for form in (secret, json.dumps(secret)[1:-1], repr(secret)[1:-1]):
            assert form not in text, name
    assert "admin" not in text
    return text


def test_no_secret_is_in_it(
    planted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = small_config(tmp_path / "daemon")
    with Daemon(config) as daemon, dial(small_config(tmp_path, daemon.endpoint)) as bus:
        bus.publish(
            "event/yard", {"camera": "yard", "note": f"mqtt://u:{SECRETS['rejected']}@h"}, "event"
        )
        bus.publish_raw("event/yard", f'{{"password":"{SECRETS["rejected"]}"}}'.encode(), "event")
        wait_for(lambda: daemon.status().rejects != {}, "the events to be refused")
        names = ("quoted", "token", "file", "credential", "mqtt", "mqtt's file", "environment")
        raw = " and ".join(SECRETS[name] for name in names)
        said = {
            "camera": "lobby",
            "state": "stalled",
            "reason": f"rtsp://u:{SECRETS['status']}@h and {raw}",
        }
        bus.answer_queries("status/lobby", lambda key, parameters: said, "status")
        connect = f"{daemon.endpoint}#connect_private_key_base64={SECRETS['endpoint']}"
        planted.write_text(
            f'{planted.read_text()}[bus]\nconnect_seconds = 0.5\nconnect = ["{connect}"]\n'
        )
        for form in ([], ["--out", str(tmp_path / "all.txt")]):
            assert main(["--config", str(planted), "--site", "site", "doctor", *form]) == 0
    out, err = capsys.readouterr()
    without_secrets(err)
    text = without_secrets(out)
    without_secrets((tmp_path / "all.txt").read_text())
    assert stat.S_IMODE((tmp_path / "all.txt").stat().st_mode) == 0o600
    for told in (
        'cameras.url.source = "rtsp://***@',
        'cameras.token.source = "rtsp://192.0.2.3:7441/stream/***/live"',
        'cameras.parameter.source = "rtsp://192.0.2.3/x?user=***&password=***&channel=1"',
        f"holds a secret: {tmp_path}/lobby (-rw-r--r--",
        f"{tmp_path}/lobby holds a secret and can be read by others",
        f"{daemon.endpoint}#connect_private_key_base64=*** is reached after",
        'lobby: {"state": "stalled", "reason": "rtsp://***@h and *** and *** and *** and ***',
        '"rejects": {',
        "CAMTOPOD_MQTT_PASSWORD",
    ):
        assert told in text


def test_a_wrong_configuration_and_nothing_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "c.toml"
    path.write_text(
        '[cameras.lobby]\nsource = "rtsp://u:hunter2@h"\npgae = 1\npassword = "hunter2"\n'
    )

    def away(config: Config) -> NoReturn:
        raise BusError(f"the bus at {', '.join(config.dials)} is away")

    (tmp_path / "state-home" / "camtopod").mkdir(parents=True)
    (tmp_path / "state-home" / "camtopod" / "journal.db").touch(0o600)
    monkeypatch.setattr(doctor, "dial", away)
    assert main(["--config", str(path), "--connect", "tcp/192.0.2.1:7447", "doctor"]) == 0
    text = capsys.readouterr().out
    assert "hunter2" not in text
    assert f"{path}:3: cameras.lobby.pgae: no such key; did you mean 'page'?" in text
    assert "journal.db: -rw-------, user" in text
    assert "== bus ==\nthe bus at tcp/192.0.2.1:7447 is away\n" in text
    assert main(["doctor", "--out", str(tmp_path / "none" / "x.txt")]) == 1
