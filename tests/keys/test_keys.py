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
from camtopod.config.settings import ConfigError, load, parse
from camtopod.keys import rules
from camtopod.keys.authority import Authority, KeysError
from camtopod.records import Event
from camtopod.serve.bus import access
from camtopod.serve.requests import BATCH_BYTES_MAX, BATCH_EVENTS_MAX

NOW = 1_800_000_000.0
DAY = 86400.0


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    made = Authority.create(tmp_path / "keys", "hq", NOW, 7300, replace=False)
    made.issue("daemon", "daemon", 1825, hosts=["hub.example", "192.0.2.1"])
    made.issue("camera", "lobby", 1825)
    made.issue("reader", "wall", 30)
    return made


def certificate(folder: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate((folder / "certificate.pem").read_bytes())


def run(*arguments: str) -> int:
    return main.main(["keys", *arguments])


# --- what is made
# -----------------------------------------------------------------------------------


def test_certificates_say_who_and_for_what(authority: Authority) -> None:
    daemon, camera = (
        certificate(authority.folder / "daemon"),
        certificate(authority.folder / "camera" / "lobby"),
    )
    names = [
        cert.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value
        for cert in (daemon, camera)
    ]
    assert names == ["daemon", "lobby"]
    assert isinstance(camera.public_key(), ec.EllipticCurvePublicKey)
    uses = [
        list(cert.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)
        for cert in (daemon, camera)
    ]
    assert uses[0] == [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]
    assert uses[1] == [ExtendedKeyUsageOID.CLIENT_AUTH], "a stolen box must not pass for the daemon"
    hosts = daemon.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert hosts.get_values_for_type(x509.DNSName) == ["hub.example", "localhost"]
    assert [str(a) for a in hosts.get_values_for_type(x509.IPAddress)] == [
        "192.0.2.1",
        "127.0.0.1",
        "::1",
    ]
    assert camera.not_valid_after_utc.timestamp() == NOW + 1825 * DAY
    assert camera.not_valid_before_utc.timestamp() < NOW, "the clock of a box may be behind"


def test_nobody_else_can_read_it(authority: Authority) -> None:
    for path in [authority.folder, *authority.folder.rglob("*")]:
        mode = stat.S_IMODE(path.stat().st_mode)
        if path.is_dir():
            assert mode == 0o700, path
        else:
            assert mode == 0o600, path
    copied = [path.name for path in (authority.folder / "camera" / "lobby").iterdir()]
    assert "ca.key" not in copied


# --- nothing is overwritten
# -------------------------------------------------------------------------


def test_nothing_is_overwritten_unless_told(authority: Authority) -> None:
    before = {path: path.read_bytes() for path in authority.folder.rglob("*.key")}
    with pytest.raises(KeysError, match="holds an authority already; --replace"):
        Authority.create(authority.folder, "hq", NOW, 7300, replace=False)
    for role, name in (("camera", "lobby"), ("reader", "wall"), ("daemon", "daemon")):
        with pytest.raises(KeysError, match=r"until 20\d\d-\d\d-\d\d\); --replace"):
            authority.issue(role, name, 10)
    assert {path: path.read_bytes() for path in authority.folder.rglob("*.key")} == before
    Authority.create(authority.folder, "hq", NOW, 7300, replace=True)
    assert (authority.folder / "authority/ca.key").read_bytes() != before[
        authority.folder / "authority/ca.key"
    ]
    assert not (authority.folder / "camera/lobby").exists(), "certificates of no authority"


def test_a_replaced_certificate_has_a_name_never_used_before(authority: Authority) -> None:
    for expected in ("lobby~2", "lobby~3"):
        authority.issue("camera", "lobby", 10, replace=True)
        valid = {c.name: c.camera for c in authority.access.certificates if c.role == "camera"}
        assert valid == {expected: "lobby"}
    authority.revoke("camera", "lobby")
    assert not [c for c in authority.access.certificates if c.role == "camera"]
    authority.issue("camera", "lobby", 10)
    again = Authority(authority.folder, NOW)
    assert [c.name for c in again.access.certificates] == ["daemon", "reader:wall", "lobby~4"]
    with pytest.raises(KeysError, match="has no certificate"):
        authority.revoke("reader", "nobody")


@pytest.mark.parametrize(
    "name", ["", "a/b", "a b", "*", "lobby~2", "daemon", "x" * 65, "..", "ü", "a\n"]
)
def test_bad_camera_names(authority: Authority, name: str) -> None:
    before = sorted(authority.folder.rglob("*"))
    with pytest.raises(KeysError, match=r"name|taken"):
        authority.issue("camera", name, 10)
    assert sorted(authority.folder.rglob("*")) == before


def test_a_name_that_fits_the_bus_but_no_certificate(authority: Authority) -> None:
    authority.issue("camera", "x" * 64, 10)
    with pytest.raises(KeysError, match="too long for a certificate"):
        authority.issue("camera", "x" * 64, 10, replace=True)
    with pytest.raises(KeysError, match="too long for a certificate"):
        authority.issue("reader", "x" * 60, 10)


def test_other_mistakes(authority: Authority, tmp_path: Path) -> None:
    with pytest.raises(KeysError, match="neither a host name nor an address"):
        authority.issue("daemon", "daemon", 10, replace=True, hosts=["tls/hub:7447"])
    with pytest.raises(KeysError, match="the authority itself ends"):
        authority.issue("camera", "late", 8000)
    with pytest.raises(KeysError, match="there is no authority in"):
        Authority(tmp_path / "none", NOW)
    (authority.folder / "authority/issued.json").write_text("{")
    with pytest.raises(KeysError, match="cannot be read"):
        Authority(authority.folder, NOW)


def test_a_folder_of_somebody_else_is_left_alone(tmp_path: Path) -> None:
    folder = tmp_path / "home"
    (folder / "camera").mkdir(parents=True, mode=0o755)
    folder.chmod(0o755)
    (folder / "camera" / "holiday.jpg").write_bytes(b"x")
    for replace in (False, True):
        with pytest.raises(KeysError, match="holds other files; name an empty or a new folder"):
            Authority.create(folder, "hq", NOW, 7300, replace=replace)
    assert (folder / "camera" / "holiday.jpg").read_bytes() == b"x"
    assert stat.S_IMODE(folder.stat().st_mode) == 0o755
    assert not (folder / "authority").exists()


def test_a_new_certificate_of_the_daemon_is_good_for_the_same_hosts(authority: Authority) -> None:
    def hosts() -> list[str]:
        names = certificate(authority.folder / "daemon").extensions.get_extension_for_class(
            x509.SubjectAlternativeName
        )
        return [str(name.value) for name in names.value]

    before = hosts()
    authority.issue("daemon", "daemon", 10, replace=True)
    assert hosts() == before, "or no box would find its daemon any more"
    authority.issue("daemon", "daemon", 10, replace=True, hosts=["other.example"])
    assert hosts() == ["other.example", "localhost", "127.0.0.1", "::1"]


# --- the command
# ------------------------------------------------------------------------------------


def test_from_nothing_to_a_site(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keys = str(tmp_path / "keys")
    assert run("--keys", keys, "list") == exits.FAILED
    assert run("--keys", keys, "init", "--site", "hq", "--host", "hub.example") == exits.DONE
    assert run("--keys", keys, "camera", "lobby", "hall", "--days", "20") == exits.DONE
    assert run("--keys", keys, "reader", "wall") == exits.DONE
    assert run("--keys", keys, "camera", "lobby") == exits.FAILED
    assert run("--keys", keys, "camera", "bad/name") == exits.FAILED
    said = capsys.readouterr()
    assert said.out == ""
    assert "PRIVATE KEY" not in said.err
    assert "camtopod: 'bad/name' cannot be a camera's name" in said.err
    assert run("--keys", keys, "revoke", "camera", "hall") == exits.DONE
    capsys.readouterr()
    assert run("--keys", keys, "list") == exits.DONE
    out, err = capsys.readouterr()
    assert [line.split()[:2] for line in out.splitlines()[1:]] == [
        ["daemon", "daemon"],
        ["lobby", "camera"],
        ["hall", "camera"],
        ["wall", "reader"],
    ]
    assert "EXPIRES SOON" in out.splitlines()[2]
    assert "revoked" in out.splitlines()[3]
    assert "warning: camera lobby: expires soon" in err
    assert [
        c.name
        for c in rules.read_access(Path(keys, "daemon/access.json").read_bytes()).certificates
    ] == [
        "daemon",
        "lobby",
        "reader:wall",
    ]


def test_a_mistake_in_the_middle_changes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = str(tmp_path / "keys")
    for wrong in (["--host", "a b"], ["--days", "20", "--authority-days", "10"]):
        assert run("--keys", keys, "init", *wrong) == exits.FAILED
        assert run("--keys", keys, "list") == exits.FAILED, "an authority without a daemon"
    assert run("--keys", keys, "init") == exits.DONE
    assert run("--keys", keys, "camera", "lobby", "hall") == exits.DONE
    before = {path: path.read_bytes() for path in Path(keys).rglob("*") if path.is_file()}
    for wrong in (
        ["camera", "new", "bad/name"],
        ["camera", "new", "lobby"],
        ["camera", "new", "new"],
        ["revoke", "camera", "lobby", "nobody"],
        ["revoke", "camera", "lobby", "lobby"],
    ):
        assert run("--keys", keys, *wrong) == exits.FAILED, wrong
        assert {
            path: path.read_bytes() for path in Path(keys).rglob("*") if path.is_file()
        } == before, wrong
    assert "nobody" in capsys.readouterr().err


def test_the_daemon_s_hosts_are_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--keys", str(tmp_path / "a"), "init") == exits.DONE
    assert (
        "valid on this machine only: add host names or addresses with --host"
        in capsys.readouterr().err
    )
    assert run("--keys", str(tmp_path / "b"), "init", "--host", "hub.example") == exits.DONE
    assert "valid for connections to hub.example" in capsys.readouterr().err


@pytest.mark.parametrize("days", ["0", "-1", "x", "1e9", "99999999"])
def test_days_are_checked(days: str, tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as caught:
        run("--keys", str(tmp_path), "init", "--days", days)
    assert caught.value.code == exits.USAGE


def test_the_examples_it_writes_are_right_where_they_are_copied_to(tmp_path: Path) -> None:
    keys = tmp_path / "made"
    run("--keys", str(keys), "--site", "hq", "init")
    run("--keys", str(keys), "--connect", "tls/hub.example:7447", "camera", "lobby", "a.b")
    run("--keys", str(keys), "--connect", "tls/hub.example:7447", "reader", "wall")
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


# --- the rules
# --------------------------------------------------------------------------------------


def test_rules_name_exact_keys_only(authority: Authority) -> None:
    control = rules.access_control(authority.access)["access_control"]
    assert (control["enabled"], control["default_permission"]) == (True, "deny")
    assert {rule["permission"] for rule in control["rules"]} == {"allow"}
    of_camera = [rule for rule in control["rules"] if rule["id"].startswith("lobby ")]
    keys = {key for rule in of_camera for key in rule["key_exprs"]}
    assert keys == {
        f"camtopo/hq/{key}"
        for key in (
            "event/lobby",
            "status/lobby",
            "store/lobby",
            "alive/grabber/lobby",
            "alive/daemon/*",
            "status/*",
        )
    }
    [asked] = [rule for rule in of_camera if "camtopo/hq/status/*" in rule["key_exprs"]]
    assert (asked["flows"], asked["messages"]) == (["egress"], ["query"]), (
        "what all are asked; it answers for itself"
    )
    said = {m for rule in of_camera if "ingress" in rule["flows"] for m in rule["messages"]}
    assert said == {
        "put",
        "query",
        "declare_queryable",
        "reply",
        "liveliness_token",
        "declare_liveliness_subscriber",
        "liveliness_query",
    }
    of_reader = [rule for rule in control["rules"] if rule["id"].startswith("reader:wall ")]
    assert not {"put", "delete", "declare_queryable"} & {
        m for rule in of_reader if "ingress" in rule["flows"] for m in rule["messages"]
    }
    assert [subject["cert_common_names"] for subject in control["subjects"]] == [
        ["daemon"],
        ["lobby"],
        ["reader:wall"],
    ]


def test_a_certificate_for_several_cameras_by_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = str(tmp_path / "keys")
    assert run("--keys", keys, "init") == exits.DONE
    assert run("--keys", keys, "camera", "nvr", "other", "--for", "hall") == exits.FAILED
    assert run("--keys", keys, "camera", "nvr", "--for", "hall", "--for", "yard") == exits.DONE
    access = rules.read_access(Path(keys, "daemon/access.json").read_bytes())
    assert access.certificates[-1].cameras == ["hall", "yard"]
    box = tmp_path / "keys" / "camera" / "nvr"
    config = load(box / "camtopod.toml")
    assert config.bus.tls.private_key == str(box / "keys/nvr/private.key")
    assert config.cameras == {}
    capsys.readouterr()
    assert run("--keys", keys, "list") == exits.DONE
    assert "for hall, yard" in capsys.readouterr().out


def test_the_router_s_file_has_the_same_rules(authority: Authority) -> None:
    text = rules.router_json5(authority.access, ["tls/[::]:7447"], 1 << 24)
    router = json.loads(text.partition("\n")[2])
    assert router["access_control"] == rules.access_control(authority.access)["access_control"]
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


# --- the configuration
# ------------------------------------------------------------------------------


def test_tls_is_whole_or_not_at_all() -> None:
    with pytest.raises(ConfigError) as caught:
        parse(
            '[bus]\nlisten = ["tcp/0.0.0.0:7447"]\n[bus.tls]\nca = "ca.pem"\ncertifcate = "c.pem"\n'
        )
    assert [(p.line, p.what) for p in caught.value.problems] == [
        (2, "bus.listen: 'tcp/0.0.0.0:7447' is not a tls/ endpoint, but [bus.tls] is set"),
        (
            3,
            "bus.tls: access is missing: a daemon that is the meeting point has to know who may do what",
        ),
        (3, "bus.tls: certificate is missing; ca, certificate and private_key go together"),
        (3, "bus.tls: private_key is missing; ca, certificate and private_key go together"),
        (5, "bus.tls.certifcate: no such key; did you mean 'certificate'?"),
    ]
    files = 'ca = "a"\ncertificate = "b"\nprivate_key = "c"\n'
    config = parse(f'[bus]\nconnect = ["tls/hub:7447"]\n[bus.tls]\n{files}')
    assert config.dials == ("tls/hub:7447",)
    assert parse(f'[bus.tls]\n{files}access = "d"\n').listens == ("tls/127.0.0.1:7447",)


def test_paths_are_relative_to_the_file_and_hold_variables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", "/run/credentials/x")
    path = tmp_path / "c.toml"
    path.write_text(
        '[bus]\nconnect = ["tls/hub:7447"]\n[bus.tls]\nca = "keys/{camera}/ca.pem"\ncertificate = "/etc/c.pem"\n'
        'private_key = "$CREDENTIALS_DIRECTORY/key"\n[cameras.a]\nsource_file = "s/a"\n'
    )
    (tmp_path / "s").mkdir()
    (tmp_path / "s/a").write_text("rtsp://u:pw@h/x\nsecond line\n")
    config = load(path).for_camera("a")
    assert config.bus.tls.ca == str(tmp_path / "keys/a/ca.pem")
    assert (config.bus.tls.certificate, config.bus.tls.private_key) == (
        "/etc/c.pem",
        "/run/credentials/x/key",
    )
    assert config.cameras["a"].source == "rtsp://u:pw@h/x"
    assert load(path).cameras["a"].source == "", "who does not grab does not need the secret"
    for content in ("", "\n", b"\xff"):
        (tmp_path / "s/a").write_bytes(content if isinstance(content, bytes) else content.encode())
        with pytest.raises(OSError, match=r"empty first line|not UTF-8"):
            load(path).for_camera("a")


def test_secrets_that_others_can_read_are_warned_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "c.toml"
    path.write_text('[cameras.a]\nsource = "rtsp://u:pw@h/x"\n')
    for mode, warned in (
        (0o600, False),
        (0o640, False),
        (0o644, True),
        (0o602, True),
        (0o660, True),
    ):
        path.chmod(mode)
        assert main.main(["check", str(path)]) == exits.DONE
        assert ("holds a secret" in capsys.readouterr().err) == warned, oct(mode)
    path.chmod(0o644)
    path.write_text('[cameras.a]\nsource = "rtsp://h/x"\n')
    main.main(["check", str(path)])
    assert "holds a secret" not in capsys.readouterr().err
    assert secret_files.find_exposed([tmp_path / "none"]) == []


def test_a_plain_endpoint_beside_certificates_is_said(tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_text(
        '[bus]\nconnect = ["tls/h:1"]\n[bus.tls]\nca = "a"\ncertificate = "b"\nprivate_key = "c"\n'
    )
    args = argparse.Namespace(config=path, site=None, connect=["tls/h:2", "tcp/h:1"])
    with pytest.raises(
        CommandError, match=r"--connect 'tcp/h:1': write tls/\.\.\., as \[bus.tls\] is set"
    ) as caught:
        configuration(args)
    assert caught.value.status == exits.USAGE
    args.connect = ["tls/h:2"]
    assert configuration(args).dials == ("tls/h:2",)


# --- what is open is said
# ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "every program of this machine"),
        ('[bus]\nlisten = ["tcp/localhost:1", "tcp/[::1]:2"]', "every program of this machine"),
        (
            '[bus]\nlisten = ["tcp/127.0.0.1:1", "tcp/0.0.0.0:7447"]',
            "NETWORK who reaches tcp/0.0.0.0:7447 can",
        ),
        ('[bus]\nlisten = ["tcp/[::]:7447"]', "ANYBODY ON THE NETWORK"),
        ('[bus]\nlisten = ["tls/hub.example:7447"]', "ANYBODY ON THE NETWORK"),
        ('[bus]\nconnect = ["tcp/hub:7447"]', "any program that reaches the bus at tcp/hub:7447"),
        ('[bus.tls]\nca = "a"\ncertificate = "b"\nprivate_key = "c"\naccess = "d"', None),
    ],
)
def test_what_is_open_is_said(text: str, said: str | None) -> None:
    found = access.openness_warning(parse(text))
    if said is None:
        assert found is None
    else:
        assert found is not None
        assert said in found
        assert "camtopod keys init" in found


def test_a_private_key_is_no_text_for_people() -> None:
    key = "-----BEGIN PRIVATE KEY-----\nMIGH\n-----END PRIVATE KEY-----\n"
    assert redact.redact(f"cannot parse {key} here") == "cannot parse ***\n here"
    assert "MIGH" not in redact.redact(key[:40])


def test_the_access_list_is_checked(tmp_path: Path, authority: Authority) -> None:
    path = tmp_path / "c.toml"
    path.write_text(
        '[bus.tls]\nca = "a"\ncertificate = "b"\nprivate_key = "c"\naccess = "access.json"\n'
    )
    for content, why in (
        (None, "cannot read the access list"),
        (b"{}", "no access list"),
        (msgspec.json.encode(authority.access), "is for site hq, but this is site site"),
    ):
        if content is not None:
            (tmp_path / "access.json").write_bytes(content)
        with pytest.raises(access.AccessError, match=why):
            access.read_access(load(path), lambda: NOW)
    with pytest.raises(access.AccessError, match=r"cannot read .*/a: No such file"):
        access.check_files(load(path))
