"""The file of a city's districts."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from camtopod.config import ConfigError, District, districts_file, owners_of, with_borders

NEIGHBOURS = [("gate", "hall"), ("hall", "yard"), ("yard", "shed"), ("gate", "elsewhere")]


def test_a_district_hears_the_neighbours_of_its_cameras_in_others() -> None:
    owners = {"yard": "south", "gate": "north", "hall": "north", "shed": "south"}

    districts = with_borders(owners, NEIGHBOURS)

    assert districts == {
        "north": District(("gate", "hall"), ("yard",)),
        "south": District(("shed", "yard"), ("hall",)),
    }
    assert owners_of(districts) == owners


def test_it_is_read_as_it_was_written(tmp_path: Path) -> None:
    districts = with_borders({"gate": "d1", "hall": "d1", "yard": "old.town"}, NEIGHBOURS)
    path = tmp_path / "districts.toml"
    text = districts_file.to_toml(districts)
    path.write_text(text)

    assert districts_file.load(path) == districts
    assert districts_file.is_districts(text.encode())
    assert districts_file.is_districts(b"# a city\r\n\r\n" + text.encode())
    assert not districts_file.is_districts(b'[site]\nname = "x"\n' + text.encode())


def test_the_tables_of_cameras_that_several_districts_hear() -> None:
    owners = {"gate": "north", "hall": "north", "yard": "south", "shed": "west"}

    tables = "\n".join(districts_file.camera_tables(with_borders(owners, NEIGHBOURS)))

    sites = {name: camera["sites"] for name, camera in tomllib.loads(tables)["cameras"].items()}
    assert sites == {
        "hall": ["north", "south"],
        "yard": ["south", "north", "west"],
        "shed": ["west", "south"],
    }


SOUND = """\
[districts.north]
cameras = ["gate", "hall"]
hears = ["yard"]

[districts.south]
cameras = ["yard"]
hears = ["hall"]
"""


@pytest.mark.parametrize(
    ("before", "after", "mistakes"),
    [
        (
            'cameras = ["yard"]',
            'cameras = ["yard", "gate"]',
            ["6: districts.south.cameras: gate is north's, too: a camera has one owner, and a "
             "name is one camera's"],
        ),
        ('cameras = ["yard"]', 'cameras = ["yard", "yard"]',
         ["6: districts.south.cameras: a camera is listed twice"]),
        ('hears = ["yard"]', 'hears = ["yard", "yard"]',
         ["3: districts.north.hears: a camera is listed twice"]),
        ('hears = ["yard"]', 'hears = ["shed", "yard"]',
         ["3: districts.north.hears: no district owns shed"]),
        ('hears = ["yard"]', 'hears = ["gate", "yard"]',
         ["3: districts.north.hears: gate is its own"]),
        ('hears = ["hall"]', "",
         ["3: districts.north.hears: it hears yard of south, which hears no camera of north"]),
        ("[districts.south]", '[districts."a/b"]',
         ["5: districts.a/b: a name is 1 to 64 of the characters A-Z a-z 0-9 _ . -"]),
        ('cameras = ["yard"]', "", [
            "3: districts.north.hears: no district owns yard",
            "5: districts.south: it owns no camera",
            "7: districts.south.hears: it hears hall of north, which hears no camera of south",
        ]),
        ('cameras = ["yard"]', "camera = 7\ncameras = [",
         ["7: districts.south.camera"]),
    ],
)  # fmt: skip
def test_every_mistake_is_told_with_its_line(before: str, after: str, mistakes: list[str]) -> None:
    text = SOUND.replace(before, after)
    assert text != SOUND

    if mistakes[0].endswith("camera"):
        with pytest.raises(ConfigError, match=r"districts:\d+: "):
            districts_file.parse(text)
        return
    with pytest.raises(ConfigError) as wrong:
        districts_file.parse(text)

    assert str(wrong.value).split("\n") == [f"districts:{mistake}" for mistake in mistakes]


@pytest.mark.parametrize(
    "text", ["", "[sites.a]\n", "districts = 7\n", "[districts.a]\nx = " + "[" * 5000]
)
def test_what_has_no_districts_is_a_mistake(text: str, tmp_path: Path) -> None:
    path = tmp_path / "districts.toml"
    path.write_text(text)

    with pytest.raises(ConfigError, match=r"districts.toml:\d+: "):
        districts_file.load(path)
