"""The configuration: values, and all mistakes at once with their lines."""

from __future__ import annotations

import operator
import re
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings, strategies as st
from paths import DEPLOY

from camtopod.cli.generated import example
from camtopod.cli.generated.example_config import attribute_docs
from camtopod.config import fields, secret_files
from camtopod.config.config_file import load, parse, without_source
from camtopod.config.settings import (
    TABLES,
    CameraSettings,
    Config,
    ConfigError,
    OtherSite,
    SiteSettings,
)
from camtopod.vision.settings import VisionSettings

EXAMPLE = DEPLOY / "camtopod.toml"


def mistakes(text: str) -> list[tuple[int, str]]:
    with pytest.raises(ConfigError) as caught:
        parse(text)
    return [(problem.line, problem.text) for problem in caught.value.problems]


def test_what_is_said_is_used() -> None:
    assert parse("") == Config()
    assert Config().listens == Config().dials == ("tcp/127.0.0.1:7447",)

    config = parse(
        '[site]\nname = "hq"\n[bus]\nlisten = ["tcp/0.0.0.0:7000"]\n[learn]\nlateness_seconds = 7\n'
        '[cameras.lobby]\nsource = "0"\n[cameras]\nhall.source = "x.mp4"\nhall.realtime = true\n'
        "[limits]\ncommit_seconds = 0\n[vision]\nworking_width = 160\n"
    )
    assert config.site.name == "hq"
    assert config.learn.lateness_seconds == 7.0
    assert config.limits.commit_seconds == 0.0
    assert config.cameras == {
        "lobby": CameraSettings(source="0", working_width=160),
        "hall": CameraSettings(source="x.mp4", realtime=True, working_width=160),
    }
    assert config.listens == ("tcp/0.0.0.0:7000",)
    assert config.dials == ("tcp/127.0.0.1:7000",)

    dialling = parse('[bus]\nconnect = ["tls/hub:7447"]')
    assert (dialling.listens, dialling.dials) == ((), ("tls/hub:7447",))

    # One file for the daemon and its clients: the daemon does not connect to itself.
    clients = '"tcp/127.0.0.1:7000", "tcp/hub:7447"'
    shared = parse(f'[bus]\nlisten = ["tcp/0.0.0.0:7000"]\nconnect = [{clients}]')
    assert (shared.peers, len(shared.dials)) == (("tcp/hub:7447",), 2)


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
refit_hours = inf
[limts]
a = 1
[limits]
spool_events_max = 0
commit_seconds = -1
[vision]
hardware_decoding = "any"
[health]
listen = "8787"
"""


def test_every_mistake_at_once_with_its_line() -> None:
    assert mistakes(WRONG) == [
        (2, "site.nmae: no such key; did you mean 'name'?"),
        (4, 'bus.connect: expected endpoints like ["tcp/127.0.0.1:7447"]'),
        (7, "cameras.bad id: a camera's id is 1 to 64 of the characters A-Z a-z 0-9 _ . -"),
        (9, "cameras.bad id.min_height: expected a number < 1.0"),
        (11, "cameras.hall.source: expected a string, got a whole number"),
        (12, "cameras.hall.realtime: expected true or false, got a string"),
        (14, "learn.lateness_seconds: expected a number, got a string"),
        (15, "learn.window_hours: expected a number > 0.0"),
        (16, "learn.spool_bytes_max: no such key; a key of this name is in [limits]"),
        (17, "learn.refit_hours: expected a number of at most 9e+09"),
        (18, "limts: no such key; did you mean 'limits'?"),
        (21, "limits.spool_events_max: expected a whole number >= 1"),
        (22, "limits.commit_seconds: expected a number >= 0.0"),
        (24, "vision.hardware_decoding: no longer needed: delete it"),
        (26, "health.listen: expected an address and a port, like 127.0.0.1:8787"),
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
        ("site = 5\n", [(1, "site: expected a table [site]")]),
        ("[shards]\ndistricts = 4\n", [(1, "shards: no longer needed: delete it")]),
        (
            "[learn]\nversion_seconds = 1e-6\n",
            [(2, "learn.version_seconds: expected a number >= 0.01")],
        ),
        (
            "[learn]\ntransit_max_seconds = 300\n",
            [
                (
                    2,
                    "learn.transit_max_seconds: no longer needed, as the longest transit time is "
                    "found from the events: delete it",
                )
            ],
        ),
        (
            '[site]\nlisten = "127.0.0.1:8781"\n[bus]\nsite = "x"\nlisten_to = 1\n[web]\nlisten = 1\n',
            [
                (2, "site.listen: no such key; a key of this name is in [health], [web]"),
                (4, "bus.site: no such key; known are connect, listen"),
                (5, "bus.listen_to: no such key; did you mean 'listen'?"),
                (7, "web.listen: expected an address and a port"),
            ],
        ),
        ("[site]\nlisten = 5\n", [(2, "site.listen: no such key; known are name")]),
        ("cameras = 5\n", [(1, "cameras: expected tables [cameras.ID]")]),
        ("[cameras]\nlobby = 'x'\n", [(2, "cameras.lobby: expected a table [cameras.lobby]")]),
        (
            '[cameras.a]\nsource_file = "x"\nsource = "0"\n',
            [(3, "cameras.a.source: give source or source_file, not both")],
        ),
        ("[cameras.daemon]\n", [(1, "cameras.daemon: this name is taken on the bus")]),
        (
            '[topology]\nneighbours = [["a", "b"], ["c", "c"]]\nnot_neighbours = [["b", "a"]]\n',
            [
                (2, "topology.neighbours: c cannot be paired with itself"),
                (3, "topology.not_neighbours: b and a are among the neighbours, too"),
            ],
        ),
        (
            '[topology]\nneighbours = [["a", ""]]\nnot_neighbours = ["a", "b"]\nnobody_leaves = 1\n',
            [
                (2, 'topology.neighbours: expected pairs of cameras, like [["lobby", "hall"]]'),
                (3, 'topology.not_neighbours: expected pairs of cameras, like [["lobby", "hall"]]'),
                (4, "topology.nobody_leaves: expected true or false, got a whole number"),
            ],
        ),
        ("[learn]\ntopology = 1\n", [(2, "learn.topology: no such key")]),
        ("[learn]\nx = '''\n[a]\n'''\n'b' . c = 1", [(2, "learn.x: no such"), (5, "learn.b: no")]),
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


def test_a_byte_order_mark_is_skipped(tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_bytes(b"\xef\xbb\xbf[site]\r\nname = 'hq'\r\n[cameras.a]\r\n")
    config = load(path)
    assert config.site.name == "hq"
    assert f"{path}:3: cameras.a" in without_source(config, path.read_text("utf-8"), path)[0]
    path.write_bytes(b"\xef\xbb\xbfhunter2\r\n")
    assert secret_files.read(path) == "hunter2"


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("a = " + "[" * 100_000 + "]" * 100_000, 1, "nested too deeply"),
        ("a = " + "{a = " * 100_000, 1, "nested too deeply"),
        (".".join("a" * 3_000) + " = 1", 1, "nested too deeply"),
        ("[site]\nname = " + "1" * 5_000, 2, "too many digits"),
    ],
)
def test_whatever_the_parser_raises_is_a_mistake_in_the_file(
    text: str, line: int, said: str
) -> None:
    ((found, what),) = mistakes(text)
    assert found == line
    assert said in what


@given(st.text(alphabet="[]{}=.,\"'#\n\\ ab1-", max_size=60))
@settings(max_examples=100)
def test_any_text_is_a_configuration_or_a_mistake_with_a_line(text: str) -> None:
    lines = []
    try:
        parse(text)
    except ConfigError as error:
        lines = [problem.line for problem in error.problems]

    assert all(1 <= line <= text.count("\n") + 1 for line in lines)


# --- settings of one camera ------------------------------------------------------------------------


def test_a_camera_has_the_settings_of_all_and_its_own() -> None:
    config = parse(
        "[cameras.a]\nsource = '0'\nanalysed_fps = 5\nmin_height = 0.1\nsensitivity = 2\n"
        "[cameras.b]\nsource = '1'\n[vision]\nanalysed_fps = 10\nworking_width = 160\n"
    )

    assert config.cameras["b"].vision == config.vision
    assert config.cameras["a"].vision == msgspec.structs.replace(
        config.vision, analysed_fps=5.0, min_height=0.1, sensitivity=2.0
    )


@pytest.mark.parametrize("site", ["north", "elsewhere"])
def test_another_name_leaves_what_else_is_set_of_the_site(site: str) -> None:
    config = parse('[site]\nname = "north"\nwalks = false\n')
    assert config.joining(site, ()).site == SiteSettings(site, walks=False)


SITES = """\
[site]
name = "north"
[bus]
connect = ["tls/north:7447"]
[bus.tls]
ca = "c/{camera}"
certificate = "b/{camera}"
private_key = "a/{camera}"
[sites.south]
connect = ["tls/south:7447"]
[sites.west]
connect = ["tls/west:7447"]
tls = {ca = "w1", certificate = "w2", private_key = "w3"}
[cameras.gate7]
sites = ["north", "south", "west"]
[cameras.lobby]
"""


def test_a_camera_of_several_sites_says_where_each_is(tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_text(SITES)
    config = load(path)

    assert config.sites_of("gate7") == ("north", "south", "west")
    assert config.sites_of("lobby") == config.sites_of("another") == ("north",)
    own = config.for_camera("gate7")
    assert own.at("north") is own
    south, west = own.at("south"), own.at("west")
    assert (south.site.name, south.dials) == ("south", ("tls/south:7447",))
    assert south.bus.tls == own.bus.tls
    assert south.bus.tls.private_key == str(tmp_path / "a/gate7")
    assert west.bus.tls.private_key == str(tmp_path / "w3")
    assert {tmp_path / "a/gate7", tmp_path / "w3"} <= {*config.secrets(path)}

    elsewhere = config.joining("south", ())
    assert (elsewhere.dials, elsewhere.sites_of("gate7")) == (("tls/south:7447",), ("south",))
    unknown = config.joining("east", ["tls/east:7447"])
    assert (unknown.dials, unknown.sites_of("gate7")) == (("tls/east:7447",), ("east",))
    same = config.joining("north", ())
    assert (same.dials, same.sites_of("gate7")) == (config.dials, config.sites_of("gate7"))


def test_sites_that_contradict_each_other() -> None:
    text = SITES.replace("tls/south", "tcp/south").replace("tls/west", "tcp/west")
    text += 'sites = ["south", "north", "east", "east"]\n[sites.north]\n[sites.up]\n'
    assert mistakes(text) == [
        (10, "sites.south.connect: 'tcp/south:7447' is not a tls/ endpoint, but [bus.tls] is set"),
        (
            12,
            "sites.west.connect: 'tcp/west:7447' is not a tls/ endpoint, but [sites.west.tls] is "
            "set",
        ),
        (17, "cameras.lobby.sites: a site is listed twice"),
        (17, "cameras.lobby.sites: the first one owns the camera and has to be this site, north"),
        (17, "cameras.lobby.sites: there is no table [sites.east] that says where east is"),
        (18, "sites.north: this is the file's own site, [site] name: [bus] says where it is"),
        (19, "sites.up: connect is missing: where is that site's router?"),
    ]
    assert mistakes("sites = 5\n") == [(1, "sites: expected tables [sites.NAME], one a site")]


def test_areas_and_doors_are_lists_of_points_or_texts() -> None:
    triangle = ((0.0, 0.0), (0.5, 0.0), (0.5, 1.0))
    for written in (
        "[[[0, 0], [0.5, 0], [0.5, 1]]]",
        '["0,0,0.5,0,0.5,1"]',
        '"0, 0, 0.5, 0, 0.5, 1"',
    ):
        camera = parse(f"[cameras.a]\nignore = {written}\ndoors = {written}\n").cameras["a"]
        assert camera.ignore == camera.doors == (triangle,)
    doors = parse("[vision]\ndoors = [[0.25, 1], '0.5,0.5']\n").vision.doors
    assert doors == (((0.25, 1.0),), ((0.5, 0.5),))


@pytest.mark.parametrize(
    "written",
    [
        "[[[0, 0], [0.2, 0]]]",
        "[[[0, 0], [640, 0], [1, 1]]]",
        '"0,0,1"',
        '["x"]',
        "[[[0, 0], [1], [1, 1]]]",
        "[[[0, nan], [1, 0], [1, 1]]]",
        "[[0.1, 0.1], [0.2, 0.1], [0.3, 0.3]]",
        "[5]",
        "0.5",
    ],
)
def test_areas_that_are_none(written: str) -> None:
    [(line, what)] = mistakes(f"[cameras.a]\nignore = {written}")
    assert (line, what[:54]) == (2, "cameras.a.ignore: expected polygons of three points or")


def test_a_camera_may_have_settings_and_no_source() -> None:
    config = parse("[cameras.a]\nmin_height = 0.1\n[cameras.b]\nsource = '0'\n"
                   "[cameras.c]\nsource_file = 'x'\n")  # fmt: skip

    (sentence,) = without_source(config, "[cameras.a]\nmin_height = 0.1\n", Path("c.toml"))
    assert sentence.startswith("c.toml:1: cameras.a: source is missing; add it")
    given = config.for_camera("a", "x.mp4").cameras["a"]
    assert (given.source, given.min_height) == ("x.mp4", 0.1)
    assert config.for_camera("c", "y.mp4").cameras["c"].source == "y.mp4", "its file is not read"
    assert config.for_camera("new", "z").cameras["new"] == CameraSettings(source="z")


# --- the example ----------------------------------------------------------------------------------


def test_the_example_is_right_and_says_every_default() -> None:
    load(EXAMPLE)
    text = example()
    assert EXAMPLE.read_text(encoding="utf-8") == text, (
        "camtopod check --example > deploy/camtopod.toml"
    )
    config = parse(re.sub(r"(?m)^# (\w+ = )", r"\1", text).replace('source_file = ""\n', ""))
    for name, kind in TABLES.items():
        if name != "site":
            assert operator.attrgetter(name)(config) == operator.attrgetter(name)(Config())
        for field in fields(name, kind):
            if f"{name}.{field.name}" not in TABLES:
                assert re.search(rf"(?m)^(# )?{field.name} = ", text), f"{name}.{field.name}"


@pytest.mark.parametrize("kind", [*TABLES.values(), CameraSettings, OtherSite, VisionSettings])
def test_every_setting_says_what_it_is(kind: type[msgspec.Struct]) -> None:
    assert set(attribute_docs(kind)) == set(kind.__struct_fields__)
