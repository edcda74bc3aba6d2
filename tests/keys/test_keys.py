"""The authority of a site: files, refusals, permissions, and the access rules it stands for."""

from __future__ import annotations

import argparse
import json
import stat
from pathlib import Path

import msgspec
import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from camtopod import codec, redact
from camtopod.cli import exits, main
from camtopod.cli.common import configuration
from camtopod.cli.exits import CommandError
from camtopod.config import secret_files
from camtopod.config.config_file import load, parse
from camtopod.config.settings import ConfigError
from camtopod.keys import rules
from camtopod.keys.authority import AUTHORITY_DAYS, Authority, KeysError
from camtopod.records import Event
from camtopod.serve.bus import access
from camtopod.serve.requests import BATCH_BYTES_MAX, BATCH_EVENTS_MAX

NOW = 1_800_000_000.0
DAY = 86400.0
FILES = 'ca = "a"\ncertificate = "b"\nprivate_key = "c"\n'


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    made = Authority.create(tmp_path / "keys", "hq", NOW)
    made.issue("daemon", "daemon", 1825, hosts=["hub.example", "192.0.2.1"])
    made.issue("camera", "lobby", 1825)
    made.issue("reader", "wall", 30)
    return made


def certificate(folder: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate((folder / "certificate.pem").read_bytes())


def contents(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def run(folder: Path, *arguments: str) -> int:
    return main.main(["keys", "--keys", str(folder), *arguments])


# --- certificates ---------------------------------------------------------------------------------


def test_certificates_say_who_and_for_what(authority: Authority) -> None:
    daemon = certificate(authority.folder / "daemon")
    camera = certificate(authority.folder / "camera" / "lobby")

    names = [
        one.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value for one in (daemon, camera)
    ]
    assert names == ["daemon", "lobby"]
    assert isinstance(camera.public_key(), ec.EllipticCurvePublicKey)
    uses = [
        list(one.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)
        for one in (daemon, camera)
    ]
    assert uses[0] == [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]
    assert uses[1] == [ExtendedKeyUsageOID.CLIENT_AUTH], "a stolen box must not pass for the daemon"
    assert authority.hosts() == ["hub.example", "192.0.2.1", "localhost", "127.0.0.1", "::1"]
    assert camera.not_valid_after_utc.timestamp() == NOW + 1825 * DAY
    assert camera.not_valid_before_utc.timestamp() < NOW, "the clock of a box may be behind"
    for path in [authority.folder, *authority.folder.rglob("*")]:
        assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600), path


def test_nothing_is_overwritten_unless_told(authority: Authority) -> None:
    before = contents(authority.folder)
    with pytest.raises(KeysError, match="holds an authority already; --replace"):
        Authority.create(authority.folder, "hq", NOW)
    for role, name in (("camera", "lobby"), ("reader", "wall"), ("daemon", "daemon")):
        with pytest.raises(KeysError, match=f"{name} has a certificate; --replace"):
            authority.issue(role, name, 10)
    assert contents(authority.folder) == before

    Authority.create(authority.folder, "hq", NOW, replace=True)
    key = authority.folder / "authority/ca.key"
    assert key.read_bytes() != before[key]
    assert not (authority.folder / "camera/lobby").exists(), "certificates of no authority"


def test_a_folder_of_somebody_else_is_left_alone(tmp_path: Path) -> None:
    picture = tmp_path / "home" / "camera" / "holiday.jpg"
    picture.parent.mkdir(parents=True)
    picture.write_bytes(b"x")
    for replace in (False, True):
        with pytest.raises(KeysError, match="holds other files; name an empty or a new folder"):
            Authority.create(tmp_path / "home", "hq", NOW, replace=replace)
    assert contents(tmp_path) == {picture: b"x"}


def test_a_replaced_certificate_has_a_name_never_used_before(authority: Authority) -> None:
    for expected in ("lobby~2", "lobby~3"):
        authority.issue("camera", "lobby", 10, replace=True)
        valid = {one.name: one.camera for one in authority.access().certificates if one.camera}
        assert valid == {expected: "lobby"}
    authority.revoke("camera", "lobby")
    assert not [one for one in authority.access().certificates if one.camera]
    authority.issue("camera", "lobby", 10)
    again = Authority(authority.folder, NOW)
    assert [one.name for one in again.access().certificates] == ["daemon", "reader:wall", "lobby~4"]


def test_a_new_certificate_of_the_daemon_is_good_for_the_same_hosts(authority: Authority) -> None:
    before = authority.hosts()
    authority.issue("daemon", "daemon", 10, replace=True)
    assert authority.hosts() == before, "or no box would find its daemon any more"
    authority.issue("daemon", "daemon", 10, replace=True, hosts=["other.example"])
    assert authority.hosts() == ["other.example", "localhost", "127.0.0.1", "::1"]


def test_what_cannot_be_issued(authority: Authority, tmp_path: Path) -> None:
    authority.issue("camera", "x" * 64, 10)
    with pytest.raises(KeysError, match="too long for a certificate"):
        authority.issue("camera", "x" * 64, 10, replace=True)
    authority.issue("camera", "late", 8000)
    ends = certificate(authority.folder / "camera/late").not_valid_after_utc.timestamp()
    assert ends == NOW + AUTHORITY_DAYS * DAY, "not after the authority"
    with pytest.raises(KeysError, match="has no certificate"):
        authority.revoke("reader", "nobody")
    with pytest.raises(KeysError, match="there is no authority in"):
        Authority(tmp_path / "none", NOW)
    (authority.folder / "authority/issued.json").write_text("{")
    with pytest.raises(KeysError, match="cannot be read"):
        Authority(authority.folder, NOW)


# --- the command ----------------------------------------------------------------------------------


def test_from_nothing_to_a_site(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keys = tmp_path / "keys"
    assert run(keys, "list") == exits.FAILED
    assert run(keys, "init", "--site", "hq", "--host", "hub.example") == exits.DONE
    assert "valid for connections to hub.example" in capsys.readouterr().err
    assert run(keys, "camera", "lobby", "hall", "--days", "20") == exits.DONE
    assert run(keys, "reader", "wall") == exits.DONE
    assert run(keys, "camera", "lobby") == exits.FAILED
    said = capsys.readouterr()
    assert said.out == ""
    assert "PRIVATE KEY" not in said.err
    assert run(keys, "revoke", "camera", "hall") == exits.DONE
    assert run(keys, "--site", "other", "list") == exits.FAILED
    capsys.readouterr()

    assert run(keys, "list") == exits.DONE
    out, err = capsys.readouterr()
    assert [line.split()[:2] for line in out.splitlines()[1:]] == [
        ["daemon", "daemon"],
        ["lobby", "camera"],
        ["hall", "camera"],
        ["wall", "reader"],
    ]
    assert out.splitlines()[2].endswith("EXPIRES SOON")
    assert out.splitlines()[3].endswith("revoked")
    assert "warning: camera lobby expires on" in err
    listed = rules.read_access((keys / "daemon/access.json").read_bytes()).certificates
    assert [one.name for one in listed] == ["daemon", "lobby", "reader:wall"]


def test_the_access_list_follows_from_the_ledger_whatever_went_before(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = tmp_path / "keys"
    run(keys, "init", "--host", "hub.example")
    run(keys, "camera", "lobby", "hall")
    in_the_way = keys / "daemon" / ".access.json.new"

    def listed() -> list[str]:
        access_list = (keys / "daemon/access.json").read_bytes()
        return [one.name for one in rules.read_access(access_list).certificates]

    for again in (["revoke", "camera", "lobby"], ["list"], ["camera", "hall"]):
        run(keys, "camera", "lobby", "--replace")
        assert len(listed()) == 3
        in_the_way.mkdir()
        assert run(keys, "revoke", "camera", "lobby") == exits.FAILED
        assert "access.json: Is a directory" in capsys.readouterr().err
        assert len(listed()) == 3
        in_the_way.rmdir()
        assert run(keys, *again) == (exits.FAILED if again[0] == "camera" else exits.DONE)
        assert listed() == ["daemon", "hall"]


@pytest.mark.parametrize(
    "wrong",
    [
        *(
            ["camera", name]
            for name in ("", "a/b", "*", "lobby~2", "daemon", "x" * 65, "..", "a\n")
        ),
        ["camera", "nvr", "--for", "bad/name"],
        *(["init", "--host", host] for host in ("a b", "192.0.2.1:7447", "12:34")),
        *(["init", "--days", days] for days in ("0", "-1", "x", "1e9", "99999999")),
    ],
)
def test_what_is_no_name_host_or_number_of_days(wrong: list[str], tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as caught:
        run(tmp_path / "keys", *wrong)
    assert caught.value.code == exits.USAGE
    assert contents(tmp_path) == {}


def test_the_examples_it_writes_are_right_where_they_are_copied_to(tmp_path: Path) -> None:
    keys = tmp_path / "made"
    run(keys, "--site", "hq", "init")
    run(keys, "--connect", "tls/hub.example:7447", "camera", "lobby", "a.b")
    run(keys, "--connect", "tls/hub.example:7447", "reader", "wall")
    for role, name in (("", "daemon"), ("camera", "lobby"), ("camera", "a.b"), ("reader", "wall")):
        box = tmp_path / f"box-{name}"
        (box / "keys").mkdir(parents=True)
        (keys / role / name).rename(box / "keys" / name)
        (box / "keys" / name / "camtopod.toml").rename(box / "camtopod.toml")
        (box / "secrets").mkdir()
        (box / "secrets" / name).write_text("rtsp://u:hunter2@192.0.2.7/x\n")
        config = load(box / "camtopod.toml")
        assert config.site.name == "hq"
        if role == "camera":
            config = config.for_camera(name)
            assert config.cameras[name].source == "rtsp://u:hunter2@192.0.2.7/x"
            assert "hunter2" not in redact.redact("it was hunter2")
        access.check_files(config)
        assert config.dials == (
            ("tls/127.0.0.1:7447",) if name == "daemon" else ("tls/hub.example:7447",)
        )
    assert access.read_access(load(tmp_path / "box-daemon/camtopod.toml"), lambda: NOW) is not None


def test_a_certificate_for_several_cameras(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = tmp_path / "keys"
    assert run(keys, "init") == exits.DONE
    assert run(keys, "camera", "nvr", "other", "--for", "hall") == exits.FAILED
    assert run(keys, "camera", "nvr", "--for", "hall", "--for", "yard") == exits.DONE
    listed = rules.read_access((keys / "daemon/access.json").read_bytes())
    assert listed.certificates[-1].cameras == ["hall", "yard"]
    box = keys / "camera" / "nvr"
    config = load(box / "camtopod.toml")
    assert config.bus.tls.private_key == str(box / "keys/nvr/private.key")
    assert config.cameras == {}
    capsys.readouterr()
    assert run(keys, "list") == exits.DONE
    assert "for hall, yard" in capsys.readouterr().out


# --- the rules ------------------------------------------------------------------------------------


def test_rules_name_exact_keys_only(authority: Authority) -> None:
    control = rules.access_control(authority.access())["access_control"]
    assert (control["enabled"], control["default_permission"]) == (True, "deny")
    assert {rule["permission"] for rule in control["rules"]} == {"allow"}
    of_camera = [rule for rule in control["rules"] if rule["id"].startswith("lobby ")]
    assert {key.removeprefix("camtopo/hq/") for rule in of_camera for key in rule["key_exprs"]} == {
        "event/lobby",
        "status/lobby",
        "store/lobby",
        "alive/grabber/lobby",
        "alive/daemon/*",
        "status/*",
    }
    [asked] = [rule for rule in of_camera if "camtopo/hq/status/*" in rule["key_exprs"]]
    assert (asked["flows"], asked["messages"]) == (["egress"], ["query"]), (
        "what all are asked; it answers for itself"
    )
    of_reader = [rule for rule in control["rules"] if rule["id"].startswith("reader:wall ")]
    assert not {"put", "delete", "declare_queryable"} & {
        message for rule in of_reader if "ingress" in rule["flows"] for message in rule["messages"]
    }

    # The file of a separate router has the same.
    text = rules.router_json5(authority.access(), ["tls/[::]:7447"], 1 << 24)
    router = json.loads(text.partition("\n")[2])
    assert router["access_control"] == control
    assert router["transport"]["link"]["tls"]["enable_mtls"] is True
    assert router["transport"]["link"]["protocols"] == ["tls"]
    assert router["transport"]["link"]["rx"]["max_message_size"] == 1 << 24
    assert router["scouting"]["multicast"]["enabled"] is False


def test_the_largest_valid_event_fits_everywhere() -> None:
    wide = "\N{CAMERA}"  # four bytes
    event = Event(
        "c" * 64, "entry", 1.7e9 + 0.123456, 0.1, 0.2, wide * 128, wide * 64, 2**63 - 1, 0.3
    )
    assert codec.event_from_msgpack(codec.to_msgpack(event)) == event
    assert codec.EVENT_BYTES_MAX < rules.EVENT_BYTES_MAX, "so that there is something to count"
    assert BATCH_BYTES_MAX + 16 * BATCH_EVENTS_MAX < rules.QUERY_BYTES_MAX


# --- the configuration ----------------------------------------------------------------------------


def test_tls_is_whole_or_not_at_all() -> None:
    with pytest.raises(ConfigError) as caught:
        parse(
            '[bus]\nlisten = ["tcp/0.0.0.0:7447"]\n[bus.tls]\nca = "ca.pem"\ncertifcate = "c.pem"\n'
        )
    assert [(p.line, p.text) for p in caught.value.problems] == [
        (2, "bus.listen: 'tcp/0.0.0.0:7447' is not a tls/ endpoint, but [bus.tls] is set"),
        (
            3,
            "bus.tls: access is missing: a daemon that is the meeting point has to know who may do what",
        ),
        (3, "bus.tls: certificate is missing; ca, certificate and private_key go together"),
        (3, "bus.tls: private_key is missing; ca, certificate and private_key go together"),
        (5, "bus.tls.certifcate: no such key; did you mean 'certificate'?"),
    ]
    config = parse(f'[bus]\nconnect = ["tls/hub:7447"]\n[bus.tls]\n{FILES}')
    assert config.dials == ("tls/hub:7447",)
    assert parse(f'[bus.tls]\n{FILES}access = "d"\n').listens == ("tls/127.0.0.1:7447",)


def test_paths_are_relative_to_the_file_and_hold_variables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", "/run/credentials/x")
    path = tmp_path / "c.toml"
    path.write_text(
        '[bus]\nconnect = ["tls/hub:7447"]\n[bus.tls]\nca = "keys/{camera}/ca.pem"\n'
        'certificate = "/etc/c.pem"\nprivate_key = "$CREDENTIALS_DIRECTORY/key"\n'
        '[cameras.a]\nsource_file = "s"\n'
    )
    (tmp_path / "s").write_text("rtsp://u:pw@h/x\nsecond line\n")

    config = load(path).for_camera("a")
    assert config.bus.tls.ca == str(tmp_path / "keys/a/ca.pem")
    assert config.bus.tls.certificate == "/etc/c.pem"
    assert config.bus.tls.private_key == "/run/credentials/x/key"
    assert config.cameras["a"].source == "rtsp://u:pw@h/x"
    assert load(path).cameras["a"].source == "", "who does not grab does not need the secret"
    for content in (b"", b"\n", b"\xff"):
        (tmp_path / "s").write_bytes(content)
        with pytest.raises(OSError, match=r"empty first line|not UTF-8"):
            load(path).for_camera("a")


def test_secrets_that_others_can_read_are_warned_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "c.toml"
    path.write_text('[cameras.a]\nsource = "rtsp://u:pw@h/x"\n')
    for mode, warned in ((0o600, False), (0o640, False), (0o644, True), (0o602, True)):
        path.chmod(mode)
        assert main.main(["check", str(path)]) == exits.DONE
        assert ("holds a secret" in capsys.readouterr().err) == warned, oct(mode)
    path.write_text('[cameras.a]\nsource = "rtsp://h/x"\n')
    main.main(["check", str(path)])
    assert "holds a secret" not in capsys.readouterr().err
    assert secret_files.find_exposed([tmp_path / "none"]) == []


def test_a_plain_endpoint_beside_certificates_is_said(tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_text(f'[bus]\nconnect = ["tls/h:1"]\n[bus.tls]\n{FILES}')
    args = argparse.Namespace(config=path, site=None, connect=["tls/h:2", "tcp/h:1"])
    with pytest.raises(CommandError, match=r"--connect 'tcp/h:1': write tls/\.\.\.") as caught:
        configuration(args)
    assert caught.value.status == exits.USAGE
    args.connect = ["tls/h:2"]
    assert configuration(args).dials == ("tls/h:2",)


# --- what is open is said -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "every program of this machine"),
        ('[bus]\nlisten = ["tcp/localhost:1", "tcp/[::1]:2"]', "every program of this machine"),
        (
            '[bus]\nlisten = ["tcp/127.0.0.1:1", "tcp/0.0.0.0:7447"]',
            "ANYBODY ON THE NETWORK who reaches",
        ),
        ('[bus]\nlisten = ["tls/hub.example:7447"]', "ANYBODY ON THE NETWORK"),
        ('[bus]\nconnect = ["tcp/hub:7447"]', "any program that reaches the bus at tcp/hub:7447"),
        (f'[bus.tls]\n{FILES}access = "d"', None),
    ],
)
def test_what_is_open_is_said(text: str, said: str | None) -> None:
    found = access.openness_warning(parse(text))
    assert (found is None) == (said is None)
    assert (said or "") in (found or "")


def test_a_private_key_is_no_text_for_people() -> None:
    key = "-----BEGIN PRIVATE KEY-----\nMIGH\n-----END PRIVATE KEY-----\n"
    assert redact.redact(f"cannot parse {key} here") == "cannot parse ***\n here"
    assert "MIGH" not in redact.redact(key[:40])


def test_the_access_list_is_checked(tmp_path: Path, authority: Authority) -> None:
    path = tmp_path / "c.toml"
    path.write_text(f'[bus.tls]\n{FILES}access = "access.json"\n')
    for content, why in (
        (None, "cannot read the access list"),
        (b"{}", "no access list"),
        (msgspec.json.encode(authority.access()), "is for site hq, but this is site site"),
    ):
        if content is not None:
            (tmp_path / "access.json").write_bytes(content)
        with pytest.raises(access.BusError, match=why):
            access.read_access(load(path), lambda: NOW)
    with pytest.raises(access.BusError, match=r"cannot read .*/a: No such file"):
        access.check_files(load(path))
