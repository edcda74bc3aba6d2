"""The site of a program that was not told one: readers take the only one, writers name it."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator
from pathlib import Path

import pytest
from fake_bus_daemon import running
from msgspec.structs import replace
from serving import free_endpoint, small_config, wait_for

from camtopod.cli.site_choice import dial_as_reader, right_site
from camtopod.client import Publisher, Site
from camtopod.config import Config, SiteSettings
from camtopod.serve.bus import BusError, dial
from camtopod.serve.daemon import Daemon


@pytest.fixture(scope="module")
def mall(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    with running(tmp_path_factory.mktemp("mall"), free_endpoint(), site="mall") as daemon:
        yield daemon


@contextlib.contextmanager
def as_reader(config: Config, site: str | None = None) -> Iterator[str]:
    """Return the site of a reader that was given ``site`` on its command line."""
    if site is not None:
        config = replace(config, site=SiteSettings(site))
    bus, config = dial_as_reader(argparse.Namespace(site=site), config)
    with bus:
        assert bus.site == config.site.name
        yield bus.site


def test_a_reader_takes_the_only_site_and_says_so(
    mall: Daemon, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    config = small_config(tmp_path, mall.endpoint)
    with caplog.at_level("INFO"), as_reader(config) as site:
        assert site == "mall"
    assert "site mall, the only one on this bus" in caplog.text


def test_a_reader_keeps_the_site_that_it_was_told(
    mall: Daemon, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    config = small_config(tmp_path, mall.endpoint)
    with as_reader(config, "hq") as site:
        assert site == "hq"
    with as_reader(replace(config, site=SiteSettings("hq"))) as site:
        assert site == "hq"
    said = "no daemon of site hq is there; there is a daemon of site mall: add --site mall"
    assert caplog.text.count(said) == 2
    caplog.clear()
    told = "no daemon of site hq is there; there is a daemon of site mall"
    with pytest.raises(BusError, match=told):
        Site.connect("hq", connect=mall.endpoint)
    with Publisher("a", "hq", mall.endpoint, state=tmp_path / "publisher"):
        wait_for(lambda: told in caplog.text, "the warning")


def test_with_several_sites_none_is_taken(mall: Daemon, tmp_path: Path) -> None:
    config = small_config(tmp_path, mall.endpoint)
    with dial(replace(config, site=SiteSettings("annex"))) as other:
        other.announce("daemon", "d2")
        with dial(config) as bus:
            assert bus.list_sites() == ["annex", "mall"]
            assert right_site(bus, config) == (
                "; there is a daemon of site annex and of site mall: add --site annex"
            )
        with as_reader(config) as site:
            assert site == "site"
        with as_reader(config, "annex") as site:
            assert site == "annex"
