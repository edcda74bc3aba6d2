"""Here the daemon waits for backlogs as it does in service."""

from __future__ import annotations

import pytest

from camtopod.serve.ingest import backlogs


@pytest.fixture(autouse=True)
def _time_for_backlogs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backlogs, "SETTLE_SECONDS", 5.0)
