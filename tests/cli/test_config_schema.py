"""The JSON Schema of the configuration: valid files pass, common mistakes do not."""

from __future__ import annotations

import json
import re
import tomllib

import jsonschema
import pytest

from camtopod.cli.generated.config_schema import schema, text
from camtopod.cli.generated.example_config import example
from camtopod.cli.main import main
from camtopod.config.settings import parse

VALIDATOR = jsonschema.Draft7Validator(schema())


def wrong(toml: str) -> list[str]:
    """Return the places where the schema finds mistakes."""
    return sorted(
        ".".join(map(str, error.path)) for error in VALIDATOR.iter_errors(tomllib.loads(toml))
    )


def test_it_is_a_schema_and_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    jsonschema.Draft7Validator.check_schema(schema())
    assert main(["check", "--schema"]) == 0
    assert capsys.readouterr().out == text()
    assert json.loads(text())["properties"].keys() == schema()["properties"].keys()


def test_the_example_is_right_with_and_without_its_defaults() -> None:
    everything = re.sub(r"(?m)^# (\w+ = )", r"\1", example())
    everything = re.sub(r'(?m)^source_file = ""\n', "", everything)  # beside a source
    assert wrong(example()) == []
    assert wrong(everything) == []
    assert parse(everything).site.name == "hq"


@pytest.mark.parametrize(
    ("toml", "where"),
    [
        ("[sight]\n", ""),
        ('[site]\nnmae = "hq"', "site"),
        ('[site]\nname = "a/b"', "site.name"),
        ('[learn]\nwindow_hours = "x"', "learn.window_hours"),
        ("[limits]\ncommit_seconds = -1", "limits.commit_seconds"),
        ("[limits]\nstatus_seconds = 0", "limits.status_seconds"),
        ('[bus]\nlisten = ["localhost"]', "bus.listen.0"),
        ('[bus.tls]\nkey = "x"', "bus.tls"),
        ("[cameras.lobby]\nspeed = 2", "cameras.lobby"),
        ("[cameras.lobby]\nanalysed_fps = 0", "cameras.lobby.analysed_fps"),
        ("[cameras.lobby]\nmask = []", "cameras.lobby"),
        ("[cameras.lobby]\nignore = [[[0, 0], [1, 0]]]", "cameras.lobby.ignore.0"),
        ("[cameras.lobby]\nignore = [[[0, 0], [1, 0], [1, 640]]]", "cameras.lobby.ignore.0"),
        ("[cameras.lobby]\nignore = [[0.5, 0.5]]", "cameras.lobby.ignore.0"),
        ("[cameras.lobby]\nsensitivity = 5", "cameras.lobby.sensitivity"),
        ('[cameras.lobby]\nsource = "a"\nsource_file = "b"', "cameras.lobby"),
        ('[cameras."a b"]\nsource = "0"', "cameras"),
        ('[cameras.daemon]\nsource = "0"', "cameras"),
        ('[health]\nlisten = "nowhere"', "health.listen"),
        ('[cameras.lobby]\nsource = ""', "cameras.lobby"),
        ('[cameras.lobby]\nsource_file = ""', "cameras.lobby"),
        ("[bus]\nconnect_seconds = 1e12", "bus.connect_seconds"),
        ("[vision]\nanalysed_fps = 0", "vision.analysed_fps"),
        ("[learn]\ntransit_max_seconds = 0", "learn.transit_max_seconds"),
    ],
)
def test_a_mistake_is_found_where_it_is(toml: str, where: str) -> None:
    assert wrong(toml) == [where]
