"""The entry of the bench."""

from __future__ import annotations

import sys

import pytest

from bench.__main__ import main


def test_a_part_without_its_packages_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "sklearn"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "sklearn", None)
    assert main(["thesis", "1"]) == 1
    said = "bench thesis needs sklearn: pip install -e '.[test,bench]'\n"
    assert capsys.readouterr().err == said
