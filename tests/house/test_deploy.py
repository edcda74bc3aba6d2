"""The files of deploy/ agree with each other, with the program, and with systemd if available."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from paths import DEPLOY

from camtopod.cli.cameras.camera_process import STOP_SECONDS
from camtopod.cli.commands.grab import LEAVE_SECONDS as GRAB_LEAVE_SECONDS
from camtopod.cli.commands.run import LEAVE_SECONDS as RUN_LEAVE_SECONDS
from camtopod.cli.main import COMMANDS, parser_of
from camtopod.serve.runtime import STALL_SECONDS

UNITS = {
    "camtopod.service": "camtopod.service",
    "camtopod-grab@.service": "camtopod-grab@lobby.service",
}
"""File -> the unit it is started as."""
OTHERS = {f: f for f in ("camtopod-web.service", "camtopod-bridge.service")}
DEVICE = [
    "PrivateDevices=no",
    "DevicePolicy=closed",
    "DeviceAllow=char-video4linux rw",
    "SupplementaryGroups=video",
]
"""What lets a camera of this machine in."""
EXPOSURE_MAX = 2.0
"""Of ten, as `systemd-analyze security` counts; what is left is the network."""
SECURITY = (DEPLOY / "security.md").read_text()


def directives(path: Path) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for line in path.read_text().splitlines():
        if (match := re.match(r"(\w+)=(.*)", line)) is not None:
            found.setdefault(match[1], []).append(match[2])
    return found


def test_what_the_configuration_names_is_handed_to_the_service() -> None:
    daemons, boxes = (
        re.findall(r'"\$CREDENTIALS_DIRECTORY/([^"]+)"', part.split("END\n```")[0])
        for part in SECURITY.split("The daemon's machine:")[1].split("Each box, here")
    )
    for file, named in zip(UNITS, (daemons, boxes), strict=True):
        drop_ins = [directives(path) for path in (DEPLOY / f"{file}.d").iterdir()]
        values = [value for drop_in in drop_ins for value in drop_in["LoadCredential"]]
        handed = {value.split(":")[0] for value in values}
        assert {name.replace("%i", "lobby") for name in handed} == set(named)


def test_no_service_shares_its_user_or_gives_up() -> None:
    for file in UNITS:
        unit = directives(DEPLOY / file)
        assert unit["DynamicUser"] == ["yes"]
        assert "User" not in unit or "@" not in file, "else cameras read each other's keys in /proc"
        assert unit["StartLimitIntervalSec"] == ["0"]
        assert unit["RestartPreventExitStatus"] == ["2 78"]
        assert unit["NoNewPrivileges"] == ["yes"]
        assert unit["UMask"] == ["0077"]
        assert unit["CapabilityBoundingSet"] == [""]
        leave_seconds = max(RUN_LEAVE_SECONDS, GRAB_LEAVE_SECONDS, STOP_SECONDS + 1.0)
        assert float(unit["TimeoutStopSec"][0]) > leave_seconds


def test_systemd_starts_again_what_hangs() -> None:
    for file in (*UNITS, *OTHERS):
        unit = directives(DEPLOY / file)
        assert unit["Type"] == ["notify"]
        assert unit["Restart"][0] in ("always", "on-failure")
        assert float(unit["WatchdogSec"][0]) > STALL_SECONDS


def assert_confined_as_the_daemon_is(file: str) -> None:
    """Check the confinement, except for what the daemon's learner needs."""
    daemon, its = directives(DEPLOY / "camtopod.service"), directives(DEPLOY / file)
    for name in list(daemon)[list(daemon).index("NoNewPrivileges") :]:
        assert its[name] == daemon[name] or name == "SystemCallFilter"
    assert its["SystemCallFilter"] == daemon["SystemCallFilter"][:2]
    assert (its["DynamicUser"], its["StartLimitIntervalSec"]) == (["yes"], ["0"])


def test_readers_are_confined_as_the_daemon_is() -> None:
    for reader in ("camtopod-web.service", "camtopod-bridge.service"):
        assert_confined_as_the_daemon_is(reader)
        [drop_in] = (DEPLOY / f"{reader}.d").iterdir()
        keys = f":/etc/camtopod/keys/{reader.removeprefix('camtopod-').removesuffix('.service')}/"
        assert all(keys in value for value in directives(drop_in)["LoadCredential"])


def test_grabbers_are_confined_as_the_daemon_is_but_for_a_device_that_is_let_in() -> None:
    unit = DEPLOY / "camtopod-grab@.service"
    assert_confined_as_the_daemon_is(unit.name)
    assert not {"SupplementaryGroups", "DeviceAllow"} & directives(unit).keys()
    assert re.findall(r"^#   (\w+=.*)$", unit.read_text(), re.MULTILINE) == DEVICE


@pytest.mark.parametrize(("file", "name"), [*UNITS.items(), *OTHERS.items()])
def test_systemd_takes_the_units(file: str, name: str, tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("needs systemd-analyze (Debian: systemd)")
    text = (DEPLOY / file).read_text()

    assert text.count("/opt/camtopod/bin/camtopod ") == 1
    unit = tmp_path / name
    unit.write_text(text.replace("/opt/camtopod/bin/camtopod ", "/bin/true "))
    shutil.copytree(DEPLOY / f"{file}.d", tmp_path / f"{name}.d")
    assert_taken(unit)
    if "grab" in name:
        (tmp_path / f"{name}.d" / "device.conf").write_text("\n".join(["[Service]", *DEVICE]))
        assert_taken(unit)


def assert_taken(unit: Path) -> None:
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(unit)], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    threshold = f"--threshold={round(10 * EXPOSURE_MAX)}"
    security = ["systemd-analyze", "security", "--offline=true", "--no-pager", threshold, str(unit)]
    done = subprocess.run(security, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_the_commands_of_the_units_exist() -> None:
    parser, _ = parser_of(COMMANDS)
    for path in DEPLOY.glob("*.service"):
        [line] = directives(path)["ExecStart"]
        arguments = [word.replace("%i", "lobby") for word in line.split()]
        assert arguments[0] == "/opt/camtopod/bin/camtopod"
        command = parser.parse_args(arguments[1:]).command
        assert command in path.name.replace("camtopod.", "run")
