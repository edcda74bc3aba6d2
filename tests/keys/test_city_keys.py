"""One authority for several sites: certificates that serve a camera in each of its sites alone."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from fake_bus_daemon import running
from serving import T0, WAIT_SECONDS, free_endpoint, small_config, wait_for

from camtopod.cli import exits, main
from camtopod.client import Publisher
from camtopod.config import BusSettings, Config, OtherSite, SiteSettings
from camtopod.config.config_file import load
from camtopod.config.settings import StateSettings, TlsSettings
from camtopod.keys import rules
from camtopod.records import Event
from camtopod.serve.bus import dial, open_daemon_session
from camtopod.serve.daemon import Daemon

FOLDERS = {"north": "daemon", "south": "site/south/daemon"}


def run(folder: Path, *arguments: str) -> int:
    return main.main(["--config", "none", "keys", "--keys", str(folder), *arguments])


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of an authority of two sites, with cameras of either and of both."""
    folder = tmp_path_factory.mktemp("city") / "keys"
    for arguments in (
        ("init", "--site", "north"),
        ("daemon", "--site", "south"),
        ("camera", "gate7", "--also", "south"),
        ("camera", "lobby"),
        ("camera", "yard", "--site", "south"),
        ("reader", "wall", "--site", "south"),
    ):
        assert run(folder, *arguments) == exits.DONE
    return folder


def allowed(keys: Path) -> dict[str, list[str]]:
    """Return the names in the access list of each site."""
    lists = {}
    for site, folder in FOLDERS.items():
        access = rules.read_access((keys / folder / "access.json").read_bytes())
        assert access.site == site
        lists[site] = [one.name for one in access.certificates]
    return lists


def test_each_site_gives_rights_to_the_names_that_it_knows(
    keys: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert allowed(keys) == {
        "north": ["daemon", "gate7", "lobby"],
        "south": ["daemon:south", "gate7", "yard", "reader:wall:south"],
    }
    modes = {path.stat().st_mode & 0o777 for path in keys.rglob("*") if path.is_dir()}
    assert modes == {0o700}
    south = rules.read_access((keys / FOLDERS["south"] / "access.json").read_bytes())
    control = rules.access_control(south)["access_control"]
    granted = {key for rule in control["rules"] for key in rule["key_exprs"]}
    assert granted
    assert all(key.startswith("camtopo/south/") for key in granted)
    assert "camtopo/south/store/gate7" in granted

    capsys.readouterr()
    assert run(keys, "list") == exits.DONE
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("gate7") and line.endswith(" in north, south") for line in lines)
    example = (keys / "camera/gate7/camtopod.toml").read_text()
    assert load(keys / "camera/gate7/camtopod.toml").sites_of("gate7") == ("north", "south")
    assert '[sites."south"]' in example


def test_a_replacement_keeps_its_sites_and_a_site_that_is_none_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = tmp_path / "keys"
    assert run(keys, "init", "--site", "north") == exits.DONE
    for arguments in (["camera", "gate7", "--also", "south"], ["camera", "a", "--site", "south"]):
        assert run(keys, *arguments) == exits.FAILED
        assert "not of south: `camtopod keys --site south daemon` adds" in capsys.readouterr().err
    assert run(keys, "daemon", "--site", "south", "--host", "south.example") == exits.DONE
    assert run(keys, "daemon", "--site", "south") == exits.FAILED, "it has one"
    assert run(keys, "camera", "gate7", "--also", "south") == exits.DONE
    said = capsys.readouterr().err
    assert f"{keys / 'site/south/daemon/access.json'} to the daemon of site south" in said

    assert run(keys, "camera", "gate7", "--replace") == exits.DONE
    assert run(keys, "daemon", "--site", "south", "--replace") == exits.DONE
    assert "connections to south.example" in capsys.readouterr().err
    assert allowed(keys) == {"north": ["daemon", "gate7~2"], "south": ["gate7~2", "daemon:south~2"]}
    assert run(keys, "reader", "wall") == run(keys, "reader", "wall", "--site", "south") == 0
    assert run(keys, "revoke", "reader", "wall", "--site", "south") == exits.DONE
    assert run(keys, "revoke", "camera", "gate7") == exits.DONE
    assert allowed(keys) == {"north": ["daemon", "reader:wall"], "south": ["daemon:south~2"]}


class City:
    """The daemons of both sites behind routers, and configurations of programs with a certificate."""

    def __init__(self, keys: Path, folder: Path, stack: contextlib.ExitStack) -> None:
        self.keys = keys
        self.folder = folder
        self.endpoints = {
            site: free_endpoint().replace("tcp/", "tls/") for site in ("north", "south")
        }
        self.daemons: dict[str, Daemon] = {}
        for site, endpoint in self.endpoints.items():
            own = FOLDERS[site]
            access = self.tls(own, keys / own / "access.json")
            router = msgspec.structs.replace(
                small_config(folder),
                site=SiteSettings(site),
                bus=BusSettings(listen=(endpoint,), tls=access),
            )
            stack.enter_context(open_daemon_session(router))
            client = BusSettings(connect=(endpoint,), tls=self.tls(own))
            self.daemons[site] = stack.enter_context(running(folder / site, "", client, site))

    def tls(self, own: str, access: Path | str = "") -> TlsSettings:
        files = [
            str(self.keys / own / name) for name in ("ca.pem", "certificate.pem", "private.key")
        ]
        return TlsSettings(*files, access=str(access))

    def config(self, own: str, site: str = "north") -> Config:
        """Return the configuration of a program of ``site`` with this certificate."""
        others = {
            name: OtherSite(connect=(endpoint,))
            for name, endpoint in self.endpoints.items()
            if name != site
        }
        return Config(
            site=SiteSettings(site),
            bus=BusSettings(connect=(self.endpoints[site],), tls=self.tls(own)),
            sites=others,
            state=StateSettings(str(self.folder / own.replace("/", "-"))),
        )

    def stored(self, site: str) -> int:
        return self.daemons[site].status().events.stored


@pytest.fixture(scope="module")
def city(keys: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[City]:
    with contextlib.ExitStack() as stack:
        yield City(keys, tmp_path_factory.mktemp("run"), stack)


def test_a_camera_s_certificate_serves_in_its_sites_and_no_other(city: City) -> None:
    events = [Event("gate7", "entry", T0 + n) for n in range(20)]
    sites = ("north", "south")
    live: set[str] = set()
    for site, daemon in city.daemons.items():
        daemon.bus.subscribe("event/gate7", lambda *_, site=site: live.add(site))
    with Publisher("gate7", config=city.config("camera/gate7"), sites=sites) as publisher:
        publisher.publish(*events[:-1])
        assert publisher.wait_stored(WAIT_SECONDS)
        publisher.publish(events[-1])
        assert publisher.wait_stored(WAIT_SECONDS)
        wait_for(lambda: live == {*sites}, "the last event, published at both")
    before = {site: city.stored(site) for site in sites}
    assert before["north"] == before["south"] == len(events)

    # One of the other site delivers to its owner alone.
    with Publisher("lobby", config=city.config("camera/lobby"), sites=sites) as publisher:
        publisher.publish(*(Event("lobby", "entry", T0 + n) for n in range(20)))
        wait_for(lambda: city.stored("north") == before["north"] + 20, "the owner to have them")
        assert not publisher.wait_stored(1.0)
    assert city.stored("south") == before["south"]


def test_the_daemon_s_certificate_of_one_site_may_do_nothing_in_another(city: City) -> None:
    own, foreign = (city.config(FOLDERS[site], site) for site in ("north", "south"))
    epochs = {site: daemon.epoch for site, daemon in city.daemons.items()}
    with dial(own) as bus:
        assert bus.query("status/daemon", one=True)
    with dial(foreign.at("north")) as bus:
        assert bus.site == "north"
        assert not bus.query("status/daemon", one=True)
        assert not bus.query("admin/reset", one=True)
    with dial(foreign) as bus:
        assert bus.query("admin/reset", one=True)
    wait_for(lambda: city.daemons["south"].epoch > epochs["south"], "the reset of its own")
    assert city.daemons["north"].epoch == epochs["north"]
