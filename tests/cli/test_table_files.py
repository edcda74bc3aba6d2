"""Tables that are no text: Parquet, Arrow, Feather and Excel."""

from __future__ import annotations

import io
import re
import sys
import zipfile
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from camtopod.cli import exits
from camtopod.cli.events.event_lines import LineReader
from camtopod.cli.exits import InputError
from camtopod.cli.main import main
from camtopod.records import Event

WALK = [
    Event("lobby", "exit", 1_700_000_000.25, 0.31, 0.88, "17"),
    Event("front_door", "entry", 1_700_000_008.0),
]
COLUMNS: dict[str, list[Any]] = {
    "Camera": ["lobby", "Front Door"],
    "kind": ["exit", "ENTRY"],
    "t": [event.t for event in WALK],
    "x": [0.31, None],
    "y": [0.88, float("nan")],
    "track": [17.0, None],
    "note": ["a", "b"],
}
MOMENTS = [datetime.fromtimestamp(event.t, UTC) for event in WALK]


def read(raw: bytes) -> list[Event]:
    reader = LineReader()
    events = [line.event for line in reader.lines("file", io.BytesIO(raw))]
    assert not reader.rejections
    return events


def parquet(columns: dict[str, list[Any]]) -> bytes:
    pyarrow = pytest.importorskip("pyarrow", reason="needs pyarrow (camtopod[tables])")
    from pyarrow import parquet

    out = io.BytesIO()
    parquet.write_table(pyarrow.table(columns), out)
    return out.getvalue()


def arrow(columns: dict[str, list[Any]], stream: bool = False) -> bytes:
    pyarrow = pytest.importorskip("pyarrow", reason="needs pyarrow (camtopod[tables])")
    from pyarrow import ipc

    out, table = io.BytesIO(), pyarrow.table(columns)
    with (ipc.new_stream if stream else ipc.new_file)(out, table.schema) as writer:
        writer.write_table(table, max_chunksize=1)
    return out.getvalue()


def feather(columns: dict[str, list[Any]]) -> bytes:
    pyarrow = pytest.importorskip("pyarrow", reason="needs pyarrow (camtopod[tables])")
    from pyarrow import feather

    out = io.BytesIO()
    feather.write_feather(pyarrow.table(columns), out)
    return out.getvalue()


def excel(columns: dict[str, list[Any]], *others: dict[str, list[Any]]) -> bytes:
    """Return a workbook with a sheet for each table, and one without a table."""
    openpyxl = pytest.importorskip("openpyxl", reason="needs openpyxl (camtopod[tables])")
    book = openpyxl.Workbook()
    book.active.append(["About this file"])
    for table in (columns, *others):
        sheet = book.create_sheet("events")
        sheet.append(["Events of Monday"])
        sheet.append([*table])
        for row in zip(*table.values(), strict=True):
            naive = [c.replace(tzinfo=None) if isinstance(c, datetime) else c for c in row]
            sheet.append([None if c != c else c for c in naive])
    out = io.BytesIO()
    book.save(out)
    return out.getvalue()


WRITERS: dict[str, Callable[[dict[str, list[Any]]], bytes]] = {
    "Parquet": parquet,
    "Arrow": arrow,
    "Arrow stream": lambda columns: arrow(columns, stream=True),
    "Feather": feather,
    "Excel": excel,
}


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize(
    "t", [COLUMNS["t"], MOMENTS, [f"{t:%Y-%m-%dT%H:%M:%S.%f}" for t in MOMENTS]]
)
def test_it_is_read_with_seconds_moments_and_texts(name: str, t: list[Any]) -> None:
    assert read(WRITERS[name]({**COLUMNS, "t": t})) == WALK


@pytest.mark.parametrize("name", WRITERS)
def test_other_names_of_columns_are_named(name: str) -> None:
    columns = {{"t": "when"}.get(key, key): values for key, values in COLUMNS.items()}
    with pytest.raises(
        InputError, match="the header has no column t: its columns are Camera, kind, w"
    ):
        read(WRITERS[name](columns))


def test_all_sheets_with_events_are_read_and_no_other() -> None:
    counts = {"camera": ["lobby"], "kind": ["exit"], "count": [7]}
    reader = LineReader()
    book = excel(counts, COLUMNS, COLUMNS | {"t": [event.t + 9 for event in WALK]})
    lines = [*reader.lines("file", io.BytesIO(book))]
    assert [line.event.t - WALK[0].t for line in lines] == [0, 7.75, 9, 16.75]
    assert [line.number for line in lines] == [3, 4, 7, 8]
    assert not reader.rejections


def test_it_is_learned(tmp_path: Path) -> None:
    path = tmp_path / "events.parquet"
    path.write_bytes(parquet(COLUMNS))
    assert main(["--config", "none", "learn", str(path), "--topology", str(tmp_path / "t")]) == 0


@pytest.mark.parametrize(
    ("beginning", "form", "package"),
    [
        (b"PAR1", "a Parquet file", "pyarrow"),
        (b"ARROW1\0\0", "an Arrow or Feather file", "pyarrow"),
        (b"PK\3\4" + bytes(26) + b"[Content_Types].xml", "an Excel file", "openpyxl"),
    ],
)
def test_without_the_extra_the_sentence_names_it(
    beginning: bytes,
    form: str,
    package: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    path = tmp_path / "events"
    path.write_bytes(beginning + bytes(90))
    assert main(["--config", "none", "learn", str(path)]) == exits.INPUT
    said = capsys.readouterr().err
    assert f"is {form}, which needs the package {package}: pip install 'camtopod[tables]'" in said


@pytest.mark.parametrize("name", ["Parquet", "Arrow", "Excel"])
def test_a_damaged_one_is_said_to_be(name: str) -> None:
    raw = WRITERS[name](COLUMNS)
    with pytest.raises(InputError, match="that cannot be read"):
        read(raw[: len(raw) // 2])


@pytest.mark.parametrize(
    "place",
    [
        rb"(PK\x01\x02..)\x14",  # of a version of the zip format to come
        rb"(PK\x03\x04.{26}xl/workbook\.xml).",  # compressed in no way
    ],
)
def test_a_workbook_in_a_damaged_zip_is_said_to_be(place: bytes) -> None:
    raw, count = re.subn(place, b"\\1\xff", excel(COLUMNS), flags=re.DOTALL)
    assert count
    with pytest.raises(InputError, match="that cannot be read"):
        read(raw)


@pytest.mark.parametrize(("text", "damage"), [(b"<sheets>", b"<sheets<"), (b"sheetId", b"sheetNo")])
def test_a_workbook_that_is_none_of_excel_is_said_to_be(text: bytes, damage: bytes) -> None:
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(excel(COLUMNS))) as parts, zipfile.ZipFile(out, "w") as copy:
        for name in parts.namelist():
            copy.writestr(name, parts.read(name).replace(text, damage))
    with pytest.raises(InputError, match="that cannot be read"):
        read(out.getvalue())
