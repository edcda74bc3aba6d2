"""Events from a table: CSV with a header, as pandas and spreadsheets write it."""

from __future__ import annotations

import io
from datetime import UTC, datetime, timedelta, timezone

import pytest

from camtopod.cli.events.event_lines import LineReader
from camtopod.cli.exits import InputError
from camtopod.records import Event

WALK = [
    Event("lobby", "exit", 1_700_000_000.25, 0.31, 0.88, "17"),
    Event("hall", "entry", 1_700_000_008.0),
]


def read(text: str | bytes) -> tuple[LineReader, list[Event]]:
    reader = LineReader()
    raw = text if isinstance(text, bytes) else text.encode()
    return reader, [line.event for line in reader.lines("my.csv", io.BytesIO(raw))]


def table(time: str, delimiter: str = ",", end: str = "\n") -> str:
    rows = [["camera", "kind", "t", "x", "y", "track", "note"]]
    for event in WALK:
        t = datetime.fromtimestamp(event.t, UTC)
        shown = {"seconds": str(event.t), "utc": f"{t.replace(tzinfo=None)}"}
        shown |= {"T": f"{t:%Y-%m-%dT%H:%M:%S.%fZ}"}
        shown |= {"zone": t.astimezone(timezone(timedelta(hours=2))).isoformat()}
        place = ["" if value is None else str(value) for value in (event.x, event.y, event.track)]
        rows.append([event.camera, event.kind, shown[time], *place, '"a, b"'])
    return "".join(delimiter.join(row) + end for row in rows)


@pytest.mark.parametrize("time", ["seconds", "utc", "T", "zone"])
def test_a_table_is_read_with_seconds_and_with_dates(time: str) -> None:
    assert read(table(time))[1] == WALK


@pytest.mark.parametrize(
    "text",
    [
        table("seconds", ";"),
        table("seconds", "\t"),
        table("seconds", end="\r\n"),
        b"\xef\xbb\xbf" + table("seconds").encode(),
        table("seconds").rstrip("\n"),
        table("seconds") + "\n,,,,,,\n",
    ],
    ids=["semicolons", "tabs", "Windows", "mark", "no last line end", "empty rows"],
)
def test_a_table_is_read_as_other_programs_write_it(text: str | bytes) -> None:
    reader, events = read(text)
    assert events == WALK
    assert not reader.rejections


def test_each_kind_of_mistake_is_counted_and_shown_once(
    capsys: pytest.CaptureFixture[str],
) -> None:
    rows = ["a,enter,1,0.5,0.5", "a,exit,yesterday,,", "a,exit,2,1.5,0.5", "a,exit,3,0.5,"]
    rows += ["a,leave,1,0.5,0.5", "a,exit,4,0.5,0.5", "a b,exit,5,,"]

    reader, events = read("camera,kind,t,x,y\n" + "\n".join(rows))

    said = capsys.readouterr().err
    assert [event.t for event in events] == [4.0]
    assert reader.summary() == (
        "1 of 7 lines were accepted; 6 of 7 lines were rejected: "
        "bad-value camera 1, bad-value kind 2, bad-value t 1, "
        "bad-value x 1, half-position 1"
    )
    for number, word in {2: "enter", 3: "yesterday", 4: "1.5", 5: "send both", 8: "a b"}.items():
        [line] = [line for line in said.splitlines() if f"my.csv:{number}: " in line]
        assert word in line
    assert "my.csv:6" not in said


@pytest.mark.parametrize(
    ("text", "mistake"),
    [
        ("camera,kind,time\na,exit,1\n", "the header has no column t"),
        ("camera;t\na;1\n", "the header has no column kind"),
        ('camera,kind,t\n"' + "a" * 200_000, "a line of more than"),
        ('camera,kind,t\n"' + "a,\n" * 70_000, "field larger than"),
    ],
)
def test_a_table_that_cannot_be_read_is_said_to_be_one(text: str, mistake: str) -> None:
    with pytest.raises(InputError, match=mistake):
        read(text)


def test_lines_of_json_are_no_table() -> None:
    line = '{"camera":"a","kind":"exit","t":1}\n'
    assert len(read(line * 2)[1]) == 2
    assert len(read("nonsense, at first\n" + line)[1]) == 1


def test_a_column_of_labels_is_read_and_bad_ones_are_counted(
    capsys: pytest.CaptureFixture[str],
) -> None:
    rows = ["lobby,exit,1700000000,Person", "hall,entry,1700000008,-", "hall,exit,1700000009,"]
    reader, events = read("camera,kind,t,label\n" + "\n".join(rows))

    assert [event.label for event in events] == ["person", None, None]
    assert reader.labels_dropped == 1
    assert not reader.rejections
    assert reader.summary() == "1 labels were not valid, their events count"
    assert "my.csv:3: label has no letter or digit" in capsys.readouterr().err
