"""The configuration: values, all mistakes at once with their lines, and the line of each key."""

from __future__ import annotations

import operator
import re
import tomllib
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings, strategies as st
from paths import DEPLOY

from camtopod.cli.generated.example_config import attribute_docs, example
from camtopod.config import fields
from camtopod.config.settings import (
    TABLES,
    CameraSettings,
    Config,
    ConfigError,
    load,
    parse,
    without_source,
)
from camtopod.config.toml_lines import key_lines
from camtopod.vision.settings import VisionSettings

EXAMPLE = DEPLOY / "camtopod.toml"


def mistakes(text: str) -> list[tuple[int, str]]:
    with pytest.raises(ConfigError) as caught:
        parse(text)
    return [(problem.line, problem.what) for problem in caught.value.problems]


def test_nothing_said_is_every_default() -> None:
    assert parse("") == Config()
    assert Config().listens == ("tcp/127.0.0.1:7447",)
    assert Config().dials == ("tcp/127.0.0.1:7447",)


def test_what_is_said_is_used() -> None:
    config = parse(
        '[site]\nname = "hq"\n[bus]\nlisten = ["tcp/0.0.0.0:7000"]\n[learn]\nlateness_seconds = 7\n'
        '[cameras.lobby]\nsource = "0"\n[cameras]\nhall.source = "x.mp4"\nhall.realtime = true\n'
        "[limits]\ncommit_seconds = 0\n[vision]\nworking_width = 160\n"
    )
    assert config.site.name == "hq"
    assert config.learn.lateness_seconds == 7.0
    assert config.limits.commit_seconds == 0.0
    assert config.vision.working_width == 160
    assert config.cameras == {
        "lobby": CameraSettings("0", vision=config.vision),
        "hall": CameraSettings("x.mp4", realtime=True, vision=config.vision),
    }
    assert config.listens == ("tcp/0.0.0.0:7000",)
    assert config.dials == ("tcp/127.0.0.1:7000",)


def test_a_daemon_that_dials_does_not_listen() -> None:
    config = parse('[bus]\nconnect = ["tls/hub:7447"]')
    assert (config.listens, config.dials) == ((), ("tls/hub:7447",))


WRONG = """\
[site]
nmae = "hq"
[bus]
connect = ["tcp/1.2.3.4:7447",
  5, "bogus"]
[cameras.lobby]
[cameras."bad id"]
source = "rtsp://u:p@h/x"
min_height = 1
[cameras.hall]
source = 5
realtime = "yes"
[learn]
lateness_seconds = "five"
window_hours = -3
spool_bytes_max = 3
transit_max_seconds = inf
[limts]
a = 1
[limits]
spool_events_max = 0
"""


def test_every_mistake_at_once_with_its_line() -> None:
    endpoint = "is not an endpoint; write it like 'tcp/127.0.0.1:7447'"
    assert mistakes(WRONG) == [
        (2, "site.nmae: no such key; did you mean 'name'?"),
        (5, f"bus.connect: 'bogus' {endpoint}"),
        (5, f"bus.connect: 5 {endpoint}"),
        (7, "cameras.bad id: a camera's id is 1 to 64 of the characters A-Z a-z 0-9 _ . -"),
        (9, "cameras.bad id.min_height: expected a number < 1.0"),
        (11, "cameras.hall.source: expected a string, got a whole number"),
        (12, "cameras.hall.realtime: expected true or false, got a string"),
        (14, "learn.lateness_seconds: expected a number, got a string"),
        (15, "learn.window_hours: expected a number > 0.0"),
        (16, "learn.spool_bytes_max: no such key; it belongs in [limits]"),
        (17, "learn.transit_max_seconds: expected a finite number"),
        (18, "limts: no such table; did you mean 'limits'?"),
        (21, "limits.spool_events_max: expected a whole number >= 1"),
    ]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "[site]\nname = hq\nnaem = 'x'\n",
            [(2, "invalid value"), (3, "site.naem: no such key; did you mean 'name'?")],
        ),
        ('[site]\nname = "hq\n', [(2, "illegal character '\\n'")]),
        ("[site\n", [(1, "expected ']' at the end of a table declaration")]),
        ("[bus]\nconnect = [\n'tcp/a:1'\n", [(3, "unclosed array")]),
        ("a = 1\na = 2\n", [(1, "a: no such table; known are"), (2, "cannot overwrite a value")]),
        ("site = 5\n", [(1, "site: expected a table [site]")]),
        ("[shards]\ndistricts = 4\n", [(1, "shards: no longer needed: delete the table")]),
        ("cameras = 5\n", [(1, "cameras: expected tables [cameras.ID]")]),
        ("[cameras]\nlobby = 'x'\n", [(2, "cameras.lobby: expected a table [cameras.lobby]")]),
        ("x = '''\n", [(1, "expected")]),
        (
            "[cameras.daemon]\nsource = '0'\n",
            [(1, "cameras.daemon: this name is taken on the bus")],
        ),
    ],
)
def test_syntax_and_shape(text: str, expected: list[tuple[int, str]]) -> None:
    found = mistakes(text)
    assert [line for line, _ in found] == [line for line, _ in expected]
    for (_, what), (_, begins) in zip(found, expected, strict=True):
        assert what.lower().startswith(begins.lower())


def test_a_file_that_is_not_text(tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_bytes(b"[site]\nname = '\xff'\n")
    with pytest.raises(ConfigError, match=re.escape(f"{path}:2: the file is not UTF-8")):
        load(path)
    with pytest.raises(OSError, match="No such file"):
        load(tmp_path / "none.toml")


@given(st.text(alphabet="[]{}=.,\"'#\n\\ ab1-", max_size=60))
@settings(max_examples=150, deadline=None)
def test_any_text_is_a_configuration_or_a_mistake_with_a_line(text: str) -> None:
    try:
        parse(text)
    except ConfigError as error:
        problems = error.problems
    else:
        return
    assert problems
    assert all(1 <= problem.line <= text.count("\n") + 1 for problem in problems)


# --- settings of one camera ------------------------------------------------------------------------


def test_a_camera_has_the_settings_of_all_and_its_own() -> None:
    config = parse(
        "[cameras.a]\nsource = '0'\nanalysed_fps = 5\nmin_height = 0.1\nsensitivity = 2\n"
        "[cameras.b]\nsource = '1'\n[vision]\nanalysed_fps = 10\nworking_width = 160\n"
    )
    own, common = config.cameras["a"].vision, config.cameras["b"].vision
    assert common == config.vision
    assert own == msgspec.structs.replace(
        config.vision, analysed_fps=5.0, min_height=0.1, sensitivity=2.0
    )
    assert config.own_vision("a") == {"analysed_fps": 5.0, "min_height": 0.1, "sensitivity": 2.0}
    assert config.common_vision("a") == {"working_width": 160}
    assert (config.own_vision("b"), config.common_vision("b")) == (
        {},
        {"analysed_fps": 10.0, "working_width": 160},
    )


@pytest.mark.parametrize("key", VisionSettings.__struct_fields__)
def test_every_key_of_vision_may_stand_in_a_camera_s_table(key: str) -> None:
    values = {"ignore": "[]", "doors": "[]", "min_height": "0.5"}
    value = values.get(key, "2")
    config = parse(f"[cameras.a]\nsource = '0'\n{key} = {value}\n")
    assert msgspec.json.encode(getattr(config.cameras["a"].vision, key)).decode() in (
        value,
        f"{value}.0",
    )
    assert config.vision == VisionSettings()


def test_areas_and_doors_are_lists_of_points_or_texts() -> None:
    triangle = ((0.0, 0.0), (0.5, 0.0), (0.5, 1.0))
    for written in (
        "[[[0, 0], [0.5, 0], [0.5, 1]]]",
        '["0,0,0.5,0,0.5,1"]',
        '"0, 0, 0.5, 0, 0.5, 1"',
    ):
        config = parse(f"[cameras.a]\nsource = '0'\nignore = {written}\ndoors = {written}\n")
        assert config.cameras["a"].vision.ignore == (triangle,)
        assert config.cameras["a"].vision.doors == (triangle,)
    doors = parse("[vision]\ndoors = [[0.25, 1], '0.5,0.5']\n").vision.doors
    assert doors == (((0.25, 1.0),), ((0.5, 0.5),))


def test_a_key_that_has_gone_is_to_be_deleted() -> None:
    text = "[vision]\nhardware_decoding = 'any'\n[cameras.a]\nspeed = 2\n[learn]\ncameras_max = 9\n"

    assert mistakes(text) == [
        (2, "vision.hardware_decoding: no longer needed: delete the line"),
        (4, "cameras.a.speed: no longer needed: delete the line"),
        (6, "learn.cameras_max: no longer needed: delete the line"),
    ]


WRONG_CAMERA = """\
[cameras.a]
source = "0"
mask = "0,0,1,1"
sensitivty = 2
sensitivity = 9
min_height = 1
ignore = [
  [[0, 0], [0.2, 0], [0.2, 0.1]],
  [[0, 0], [640, 0], [1, 1]], "0,0,1",
  [[0, 0], [1, 0]],
  [[0, 0], [1], [1, 1]],
  5,
  "x",
  [[0, nan], [1, 0], [1, 1]],
  [[0, true], [1, 0], [1, 1]],
]
doors = [[0.5, 0.5], [[0.1, 0.1], [0.2, 0.1]], []]
[cameras.b]
ignore = [[0.1, 0.1], [0.2, 0.1], [0.3, 0.3]]
doors = 0.5
lateness_seconds = 3
"""


def test_every_mistake_in_a_camera_s_settings() -> None:
    fraction = "is not between 0 and 1; divide pixels by the picture's width or height"
    points = "a polygon has three points or more"
    polygon = "[[x, y], [x, y], [x, y]]"
    assert mistakes(WRONG_CAMERA) == [
        (3, "cameras.a.mask: no such key; it is called 'ignore' here"),
        (4, "cameras.a.sensitivty: no such key; did you mean 'sensitivity'?"),
        (5, "cameras.a.sensitivity: expected a number <= 4.0"),
        (6, "cameras.a.min_height: expected a number < 1.0"),
        (9, "cameras.a.ignore: 3 numbers are not pairs of x and y"),
        (9, f"cameras.a.ignore: 640 {fraction}"),
        (10, f"cameras.a.ignore: {points}, not 2"),
        (11, "cameras.a.ignore: a point is [x, y], not [1]"),
        (12, f"cameras.a.ignore: expected a polygon, {polygon}"),
        (13, "cameras.a.ignore: 'x' is not a list of numbers with commas, \"x,y,x,y,...\""),
        (14, f"cameras.a.ignore: nan {fraction}"),
        (15, "cameras.a.ignore: a point is [x, y], not [0, True]"),
        (17, f"cameras.a.doors: {points}, not 0"),
        (17, f"cameras.a.doors: {points}, not 2"),
        (19, f"cameras.b.ignore: {points}: write [{polygon}]"),
        (20, f"cameras.b.doors: expected a list of polygons, such as [{polygon}]"),
        (21, "cameras.b.lateness_seconds: no such key; it belongs in [learn]"),
    ]


def test_a_camera_may_have_settings_and_no_source() -> None:
    text = (
        "[cameras.a]\nmin_height = 0.1\n[cameras.b]\nsource = '0'\n[cameras.c]\nsource_file = 'x'\n"
    )
    config = parse(text)
    assert config.cameras["a"].source == ""
    (sentence,) = without_source(config, text, Path("c.toml"))
    assert sentence.startswith("c.toml:1: cameras.a: source is missing; add it")
    given = config.for_camera("a", "x.mp4").cameras["a"]
    assert (given.source, given.vision.min_height) == ("x.mp4", 0.1)
    assert config.for_camera("c", "y.mp4").cameras["c"].source == "y.mp4", "its file is not read"
    assert config.for_camera("new", "z").cameras["new"] == CameraSettings("z")
    for empty in ("source = ''", "source_file = ''", "source = ''\nsource_file = ''"):
        assert mistakes(f"[cameras.a]\n{empty}\n")[0][1].endswith("is empty")


# --- which line a key is on -----------------------------------------------------------------------

LINES = '''\
top = 1 # comment = 2
"quoted key" = "a # b"
'lit.eral' = 'c = d'
dotted . "x y".z = 3
multi = """
not = "a key"
[nor.a.table] \\"""
"""
literal = \'\'\'
x = 1\'\'\'
array = [ # comment ]
  1,
  "two]", # more
  [3, [4,
   5]],
]
when = 1979-05-27 07:32:00
inline = { a = 1, b.c = [ {d = 2}, 3 ], "e" = """
""" }
[table]
key = true
[table."sub.table"]
key = -1.5e3
[[list]]
name = "one"
[[list]]
name = "two"
[list.inner]
deep = 0x1F
[[list.many]]
k = 1
[[list.many]]
k = 2
'''


def paths(value: Any, path: tuple[str | int, ...] = ()) -> set[tuple[str | int, ...]]:
    """Yield every path into the output of tomllib."""
    found = {path} if path else set()
    pairs = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value)
        if isinstance(value, list)
        else ()
    )
    for key, inner in pairs:
        found |= paths(inner, (*path, key))
    return found


def test_lines_of_a_document_with_everything_in_it() -> None:
    lines = key_lines(LINES)

    assert set(lines) == paths(tomllib.loads(LINES))
    assert lines["multi",] == 5
    assert lines["array", 2, 1, 1] == 15
    assert lines["inline", "b", "c", 0, "d"] == 18
    assert lines["table", "sub.table", "key"] == 23
    assert lines["list", 1, "many", 1, "k"] == 33


keys = st.text(alphabet="ab.\"'=#[] ", max_size=4)
scalars = st.one_of(
    st.integers(-5, 5),
    st.booleans(),
    st.text(alphabet="ab\"'\n\\#=[]{},", max_size=8),
    st.floats(allow_nan=False),
)
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(keys, inner, max_size=3),
    max_leaves=6,
)


def render(value: Any) -> str:
    """Render inline TOML, with arrays over several lines and some multi-line strings."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        text = msgspec.json.encode(value).decode()
        return f'""{text}""' if len(value) % 2 and not value.endswith('"') else text
    if isinstance(value, list):
        return "[\n" + "".join(f" {render(item)}, # ]\n" for item in value) + "]"
    if isinstance(value, dict):
        return (
            "{"
            + ", ".join(f"{render_key(key)} = {render(item)}" for key, item in value.items())
            + "}"
        )
    return repr(value)


def render_key(key: str) -> str:
    return msgspec.json.encode(key).decode() if '"' in key or "'" in key or not key else f"'{key}'"


@given(
    st.dictionaries(keys, values, max_size=4),
    st.dictionaries(keys, st.dictionaries(keys, values, max_size=3)),
)
@settings(max_examples=100, deadline=None)
def test_lines_agree_with_the_parser(
    top: dict[str, Any], tables: dict[str, dict[str, Any]]
) -> None:
    tables = {name: table for name, table in tables.items() if name not in top}
    text, expected = "", {}
    for key, value in top.items():
        expected[(key,)] = text.count("\n") + 1
        text += f"{render_key(key)} = {render(value)}\n"
    for name, table in tables.items():
        expected[(name,)] = text.count("\n") + 1
        text += f"[ {render_key(name)} ] # x\n"
        for key, value in table.items():
            expected[(name, key)] = text.count("\n") + 1
            text += f"{render_key(key)}={render(value)}\n"
    lines = key_lines(text)
    assert set(lines) == paths(tomllib.loads(text))
    assert {path: lines[path] for path in expected} == expected


# --- the example ----------------------------------------------------------------------------------


def test_the_example_is_right_and_says_every_default() -> None:
    text = example()
    assert parse(text).site.name == "hq"
    commented_in = re.sub(r"(?m)^# (\w+ = )", r"\1", text)
    config = parse(commented_in)
    defaults = Config()
    for name in TABLES:
        if name != "site":
            assert operator.attrgetter(name)(config) == operator.attrgetter(name)(defaults)
    for name, kind in TABLES.items():
        for field in fields(name, kind):
            if f"{name}.{field.name}" not in TABLES:
                assert re.search(rf"(?m)^(# )?{field.name} = ", text), f"{name}.{field.name}"


@pytest.mark.parametrize("kind", [*TABLES.values(), CameraSettings])
def test_every_setting_says_what_it_is(kind: type[msgspec.Struct]) -> None:
    assert set(attribute_docs(kind)) == set(kind.__struct_fields__)


def test_the_deployed_example_is_the_program_s() -> None:
    load(EXAMPLE)
    assert EXAMPLE.read_text(encoding="utf-8") == example(), (
        "camtopod check --example > deploy/camtopod.toml"
    )


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ('[site]\nname = "a b"', "site.name: expected 1 to 64 of the characters A-Z a-z 0-9 _ . -"),
        (
            '[health]\nlisten = "8787"',
            "health.listen: expected an address and a port, like 127.0.0.1:8787",
        ),
    ],
)
def test_a_pattern_is_told_in_words(text: str, what: str) -> None:
    assert mistakes(text) == [(2, what)]


def test_numbers_that_would_end_the_daemon_later_are_refused_here() -> None:
    assert mistakes("[learn]\ntransit_max_seconds = 0\nwindow_hours = 0") == [
        (2, "learn.transit_max_seconds: expected a number > 0.0"),
        (3, "learn.window_hours: expected a number > 0.0"),
    ]
    assert mistakes(
        "[learn]\nversion_seconds = 0\n[limits]\nstatus_seconds = 1e15\ncommit_seconds = -1"
    ) == [
        (2, "learn.version_seconds: expected a number > 0.0"),
        (4, "limits.status_seconds: expected at most 9e+09"),
        (5, "limits.commit_seconds: must not be negative"),
    ]
