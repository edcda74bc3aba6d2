"""The journal is removed or replaced under the running daemon.

From then on nothing is acknowledged, the fault is reported, and after a restart nothing is missing
that a spool still has.
"""

from __future__ import annotations

import contextlib
import logging
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from grabber import Grabber, stored
from serving import wait_for

BEFORE, AFTER = 100, 20
"""Events that are stored before, and that come after it."""


@pytest.fixture
def grabber(tmp_path: Path) -> Iterator[Grabber]:
    with contextlib.closing(Grabber(tmp_path)) as one:
        yield one


def replaced_by_a_copy(state: Path) -> None:
    shutil.copyfile(state / "journal.db", state / "copy.db")
    (state / "copy.db").rename(state / "journal.db")


LOSSES: dict[str, Callable[[Path], object]] = {
    "removed": lambda state: (state / "journal.db").unlink(),
    "replaced by a copy": replaced_by_a_copy,
    "directory removed": shutil.rmtree,
}


@pytest.mark.parametrize("loss", LOSSES)
def test_nothing_is_acknowledged_from_then_on_and_what_the_spools_have_comes_back(
    loss: str, grabber: Grabber, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    state = tmp_path / "state"
    with grabber.daemon() as daemon:
        grabber.attach()
        grabber.publish(BEFORE)
        grabber.await_stored()
        LOSSES[loss](state)
        wait_for(lambda: daemon.status().state == "degraded", "it to notice")
        received = daemon.status().events.received
        grabber.publish(AFTER)
        wait_for(lambda: daemon.status().events.received > received, "some of the events")

        reason = daemon.status().reason
        assert f"{state}/journal.db was removed or replaced while it is in use" in reason
        assert daemon.unready() == [reason]
        assert daemon.failing() == [], "a restart by a supervisor would make the loss final"
        assert caplog.text.count("cannot write the journal, so nothing is acknowledged") == 1
    assert grabber.publisher.waiting == AFTER

    with grabber.daemon() as daemon:
        grabber.await_stored()
        wait_for(lambda: daemon.status().journal.entries == grabber.made, "all events")
        assert daemon.status().state == "running"
    assert [seq for seq, _ in stored(state)] == list(range(1, grabber.made + 1))


@pytest.mark.parametrize("name", ["state", "state/journal.db"])
def test_it_goes_on_by_itself_when_the_file_is_back(
    name: str, grabber: Grabber, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    state = tmp_path / "state"
    with caplog.at_level(logging.INFO), grabber.daemon() as daemon:
        grabber.attach()
        grabber.publish(BEFORE)
        grabber.await_stored()
        (tmp_path / name).rename(tmp_path / f"{name}-elsewhere")
        wait_for(lambda: daemon.status().state == "degraded", "it to notice")
        grabber.publish(AFTER)

        (tmp_path / f"{name}-elsewhere").rename(tmp_path / name)

        grabber.await_stored()
        assert daemon.status().state == "running"
    assert "the journal can be written again" in caplog.text
    assert [seq for seq, _ in stored(state)] == list(range(1, grabber.made + 1))
