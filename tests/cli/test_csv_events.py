"""Events from a table: CSV with a header, as pandas and spreadsheets write it."""

from __future__ import annotations

import io
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import pytest

from camtopod.cli import exits
from camtopod.cli.events.event_lines import LineReader
from camtopod.cli.exits import InputError
from camtopod.cli.main import main
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
    rows += ["a,leave,1,0.5,0.5", "a,exit,4,0.5,0.5", "a!b,exit,5,,"]

    reader, events = read("camera,kind,t,x,y\n" + "\n".join(rows))

    said = capsys.readouterr().err
    assert [event.t for event in events] == [4.0]
    assert reader.summary() == (
        "1 of 7 lines were accepted; 6 of 7 lines were rejected: "
        "bad-value camera 1, bad-value kind 2, bad-value t 1, "
        "bad-value x 1, half-position 1"
    )
    for number, word in {2: "enter", 3: "yesterday", 4: "1.5", 5: "send both", 8: "a!b"}.items():
        [line] = [line for line in said.splitlines() if f"my.csv:{number}: " in line]
        assert word in line
    assert "my.csv:6" not in said


@pytest.mark.parametrize(
    ("text", "mistake"),
    [
        ("camera,kind,time\na,exit,1\n", "the header has no column t"),
        ("camera;t\na;1\n", "the header has no column kind"),
        ("a,exit,1,0.5\nb,entry,2,0.5\n", "rename those that are meant, or put a header above"),
        (
            "cam,event,timestamp,px\na,exit,1,0\n",
            "no column camera and no kind and no t: its columns are cam, event, timestamp, px; rename",
        ),
    ],
)
def test_a_table_that_cannot_be_read_is_said_to_be_one(text: str, mistake: str) -> None:
    with pytest.raises(InputError, match=mistake):
        read(text)


def test_a_track_that_is_a_float_in_json_is_a_whole_number() -> None:
    """As pandas writes a column of numbers that has gaps."""
    begin = '{"camera":"a","kind":"exit","t":1,"track":'
    lines = [f"{begin}{track}}}" for track in ("17.0", "17.5")]
    assert [event.track for event in read("\n".join(lines))[1]] == ["17"]


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


# --- as other programs write it ---

NAMES = ["camera", "kind", "t", "x", "y", "track"]
ROWS = [
    ["lobby", "exit", "1700000000.25", "0.31", "0.88", "17"],
    ["hall", "entry", "1700000008.0", "", "", ""],
]


def text(
    rows: list[list[str]] = ROWS, delimiter: str = ",", end: str = "\n", names: list[str] = NAMES
) -> str:
    return "".join(delimiter.join(row) + end for row in [names, *rows])


def with_comma(row: list[str]) -> list[str]:
    return [*row[:2], *(cell.replace(".", ",") for cell in row[2:])]


DIALECTS = {
    "decimal commas": text([with_comma(row) for row in ROWS], ";"),
    "quoted decimal commas": text([[f'"{cell}"' for cell in with_comma(row)] for row in ROWS]),
    "bars": text(delimiter="|"),
    "blanks": text([[cell or "NA" for cell in row] for row in ROWS], " "),
    "separator": "sep=;\r\n" + text(delimiter=";", end="\r\n"),
    "comments": "# exported\n\n" + text() + "# end\n",
    "header in a comment": "#" + text(),
    "a title": "Events of Monday\n\n" + text(),
    "capitals": text(
        [[r[0], r[1].upper(), *r[2:]] for r in ROWS], names=[n.upper() for n in NAMES]
    ),
    "NA": text([[cell or "NA" for cell in row] for row in ROWS]),
    "nan": text([[cell or "nan" for cell in row] for row in ROWS]),
    "NULL": text([[cell or "NULL" for cell in row] for row in ROWS]),
    "float tracks": text([[*row[:5], row[5] and "17.0"] for row in ROWS]),
    "float tracks with commas": text([[*with_comma(r)[:5], r[5] and "17,0"] for r in ROWS], ";"),
    "old systems": text(end="\r"),
    "an index": text([[str(k), *row] for k, row in enumerate(ROWS)], names=["", *NAMES]),
    "other order": text([row[::-1] for row in ROWS], names=NAMES[::-1]),
    "UTC": text([["lobby", "exit", "2023-11-14 22:13:20.25 UTC", *ROWS[0][3:]], ROWS[1]]),
    "a header again": text(ROWS[:1]) + "\ufeff" + text(ROWS[1:]),
    "a header in another order": text(ROWS[:1])
    + text([row[::-1] for row in ROWS[1:]], ";", names=NAMES[::-1]),
    "in columns": "".join(
        "".join(f"{cell or 'NA':15}" for cell in row) + "\n"
        for row in [NAMES, ["-" * 9] * 6, *ROWS]
    ),
    "with rules": "".join(
        f"| {' | '.join(row)} |\n" for row in [NAMES, [":---"] * 6, *ROWS, [""] * 6]
    ),
    "\\N": text([[cell or "\\N" for cell in row] for row in ROWS]),
    "slashes": text([["lobby", "exit", "2023/11/14 22:13:20.25", *ROWS[0][3:]], ROWS[1]]),
}


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
def test_dialects_are_read(dialect: str, encoding: str) -> None:
    reader, events = read(DIALECTS[dialect].encode(encoding))
    assert events == WALK
    assert not reader.rejections


def test_names_are_read_in_the_encoding_of_windows_too() -> None:
    """And become ids, as those that `camtopod ingest` reads."""
    rows = [["K\xfcche", *ROWS[0][1:]], ["Front Door", *ROWS[1][1:]], ["K\xfcche", *ROWS[1][1:]]]
    for encoding in ("utf-8", "cp1252", "utf-16"):
        _, events = read(text(rows).encode(encoding))
        assert [event.camera for event in events] == ["kuche", "front_door", "kuche"]


def test_a_camera_whose_number_was_written_as_a_float_is_the_same() -> None:
    _, events = read(text([["1.0", *ROWS[0][1:]], ["1", *ROWS[1][1:]]]))
    assert [event.camera for event in events] == ["1", "1"]


@pytest.mark.parametrize("row", ["hall,ent", "hall,entry,1700", "hall,entry,1700000008.0,,"])
def test_a_row_that_is_not_written_to_its_end_is_no_event(row: str) -> None:
    """Else ``1700`` would be a time, and the row of the finished file a repeat of that event."""
    reader, events = read(text(ROWS[:1]) + row)
    assert events == WALK[:1]
    assert reader.rejections == {"malformed": 1}


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("a,exit,1,960,0.5", "x and y are fractions of the picture, 0 to 1 (pixels"),
        ("a,exit,1,0.5,-1", "divide them by its width and height - at `$.y`"),
        ("a,leave,1,0.5,0.5", "kind is entry or exit, in no other words"),
        ('{"camera":"a","kind":"exit","t":1,"x":NaN,"y":NaN}', "NaN is not JSON: write null"),
        ("2026-01-01 INFO {}", "text stands before the event: cut it off, with sed"),
        ("host grab[1]: {}", "text stands before the event: cut it off, with sed"),
    ],
)
def test_it_is_said_what_a_value_should_be(
    row: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    read(row if "{" in row else f"camera,kind,t,x,y\n{row}\n")
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("times", "words"),
    [
        (
            ["2023-11-14T22:13:20Z", "2023-11-14 22:13:21", "2023-11-14 23:13:22+01:00"],
            "t has no time zone, while those before have one",
        ),
        (
            ["2023-11-14 22:13:20", "2023-11-14 22:13:21 UTC", "2023-11-14"],
            "t has a time zone, while those before have none",
        ),
    ],
)
def test_dates_with_and_without_a_time_zone_are_not_mixed(
    times: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    reader, events = read(
        "camera,kind,t\n" + "".join(f"a,exit,{t}\n" for t in [*times, "1700000003"])
    )
    assert reader.rejections == {"time-zone t": 1}
    assert [event.t for event in events[::2]] == [1_700_000_000.0, 1_700_000_003.0]
    assert words in capsys.readouterr().err


def test_a_cell_that_is_no_date_says_nothing_about_the_time_zone_of_dates() -> None:
    moments = ("unknown", "2023-11-14T22:13:20Z", "2023-11-14T22:13:21Z")
    reader, events = read("camera,kind,t\n" + "".join(f"a,exit,{t}\n" for t in moments))
    assert [event.t for event in events] == [1_700_000_000.0, 1_700_000_001.0]
    assert reader.rejections.total() == 1


def test_two_names_of_one_id_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    reader, events = read(
        text([["Hall", *ROWS[1][1:]], ["H all", *ROWS[1][1:]], ["h_all", *ROWS[1][1:]]])
    )
    assert [event.camera for event in events] == ["Hall", "h_all"]
    assert reader.rejections == {"same-camera": 1}
    assert "cameras 'H all' and 'h_all' would both be h_all" in capsys.readouterr().err


@pytest.mark.parametrize("quote", ['"lobby,exit', 'lobby,"exit', 'lob"by,exit', 'lobby,exit,"'])
def test_a_stray_quotation_mark_costs_one_row(quote: str) -> None:
    rows = [["c", "exit", str(k)] for k in range(600)]
    lines = text(rows, names=NAMES[:3]).splitlines()
    lines[100] = f"{quote},1"
    reader, events = read("\n".join(lines))
    assert len(events) >= 599
    assert reader.lines_read == 600
    assert len(events) + reader.rejections.total() == 600


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("length", [100_000, 300_000])
def test_a_line_that_is_too_long_costs_one_row(end: str, length: int) -> None:
    rows = [["c", "exit", str(k)] for k in range(600)]
    lines = text(rows, names=NAMES[:3]).splitlines()
    lines[100] += " " * length
    reader, events = read(end.join(lines))
    assert [event.t for event in events] == [*range(99), *range(100, 600)]
    assert reader.rejections == {"too-long": 1}


def test_more_cells_than_columns_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    """As of decimal commas in a table with commas."""
    reader, _ = read(text([with_comma(row) for row in ROWS]))
    assert reader.rejections == {"too-long": 2}
    assert "9 cells below 6 columns: decimal commas, " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"SQLite format 3\0" + bytes(90), "sqlite3 -header -csv"),
        (b"\x89HDF\r\n\x1a\n" + bytes(90), "an HDF5 file"),
        (b"\x04\x22\x4d\x18d@", "lz4 -dc"),
        (bytes(8) + b"DUCK" + bytes(90), "a DuckDB database"),
        (b"\x93NUMPY\x01\0", "a NumPy array"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "an old Excel"),
        (bytes(range(1, 200)), "is binary"),
        (b"<!DOCTYPE html>\n<html><body>", "a web page"),
        (
            b"-- dump\n/* by */;\nSET x = 1;\nCREATE TABLE e (camera text);\n",
            "a dump of a database",
        ),
        (b"COPY public.events (camera, kind, t) FROM stdin;\n", "a dump of a database"),
        (b'{"type": "FeatureCollection", "features": [{"type":', "jq -c '.features[].properties'"),
        (b'{"camera":{"0":"a","1":"b"},"kind":{', 'orient="records"'),
        (b'{"0":{"camera":"a","kind":"exit"', 'orient="records"'),
        (b"PK\3\4" + bytes(26) + b"mimetypeapplication/vnd.oasis.open", "an OpenDocument file"),
        (b'{"columns":["camera","kind"],"index":[0', 'orient="records"'),
        (b'[["a","exit",1],["b","entry",2]]', "array of arrays"),
        (b'{"events": [{"camera":"a","kind":"exit","t":1}]}', "jq -c '.[] | arrays | .[]'"),
        (
            b'{\n "version": 1,\n "site": "hq",\n "events": [\n  {\n',
            "jq -c '.[] | arrays | .[]'",
        ),
        (
            b'{"camera":"a","kind":"exit","t":"2023-11-14T22:13:20"}',
            "nor ISO 8601 in a table",
        ),
    ],
)
def test_what_is_neither_lines_nor_a_table_is_named_and_not_quoted(
    content: bytes, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "events"
    path.write_bytes(content)
    assert main(["--config", "none", "learn", str(path)]) == exits.INPUT
    said = capsys.readouterr().err
    assert words in said
    assert "\\x" not in said
    assert "JSON is malformed" not in said
