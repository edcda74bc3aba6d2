"""Tables that are no text: Parquet, Arrow, Feather and Excel. Needs the extra ``[tables]``."""

from __future__ import annotations

import itertools
import re
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from io import BufferedReader
from typing import Any

from camtopod.cli.events.table_rows import COLUMNS, Rows, count_needed
from camtopod.cli.exits import InputError
from camtopod.codec import Rejected

HEADER_ROWS_MAX = 20
"""Rows of a sheet within which the header comes."""
_FORMS = {
    rb"PAR1": "a Parquet file",
    rb"ARROW1": "an Arrow or Feather file",
    rb"\xff\xff\xff\xff.{3}\0": "an Arrow stream",
    rb"FEA1": "a Feather file",
    rb"PK\x03\x04.{26,400}(\[Content_Types\]|_rels/|xl/|docProps/)": "an Excel file",
}
_DAMAGES = (
    *(ValueError, TypeError, OSError, EOFError, LookupError, NotImplementedError),
    *(zipfile.BadZipFile, zlib.error, SyntaxError),  # the last one is of XML
)
"""What the packages raise for a file that is damaged."""


def form_of(beginning: bytes) -> str | None:
    """Return the form of a file that begins like this; None if it is no such table."""
    return next(
        (form for magic, form in _FORMS.items() if re.match(magic, beginning, re.DOTALL)), None
    )


def rows(
    path: str, file: BufferedReader, form: str, needed: Sequence[str] = COLUMNS
) -> Iterator[tuple[int, bytes | Rejected]]:
    """Yield each row as a line of JSON, with its number (from 1), over all sheets.

    Raises `InputError`, also if the package that reads the form is not installed.
    """
    try:
        tables = _sheets(file, needed) if "Excel" in form else _batches(file, form)
        number = 0
        for names, rows_before, batch in tables:
            table = Rows(path, names, needed)
            number += rows_before
            for cells in batch:
                number += 1
                if (line := table.line(cells)) is not None:
                    yield number, line
    except ModuleNotFoundError as error:
        raise InputError(
            f"{path} is {form}, which needs the package {error.name}: pip install "
            "'camtopod[tables]', or save it as CSV"
        ) from None
    except _DAMAGES as error:
        raise InputError(f"{path} is {form} that cannot be read: {error}") from None


Table = tuple[list[str], int, Iterator[Sequence[Any]]]
"""Names of the columns, number of rows that these are in or below, rows."""


def _batches(file: BufferedReader, form: str) -> Iterator[Table]:
    """Yield the parts of a file of columns."""
    import pyarrow
    from pyarrow import feather, ipc, parquet

    if "Parquet" in form:
        batches = parquet.ParquetFile(file).iter_batches()
    elif "stream" in form:
        batches = ipc.open_stream(file)
    elif form == "a Feather file":
        batches = feather.read_table(file).to_batches()
    else:
        reader = ipc.open_file(file)
        batches = (reader.get_batch(k) for k in range(reader.num_record_batches))
    for batch in batches:
        columns = [_plain(pyarrow, column) for column in batch.columns]
        yield batch.schema.names, 0, zip(*columns, strict=True)


def _plain(pyarrow: Any, column: Any) -> list[Any]:
    """Return the values of a column; moments as seconds since 1970."""
    if pyarrow.types.is_timestamp(column.type):
        whole = column.cast(pyarrow.timestamp("us", column.type.tz), safe=False)
        return [us if us is None else us / 1e6 for us in whole.cast("int64").to_pylist()]
    values: list[Any] = column.to_pylist()
    return values


def _sheets(file: BufferedReader, needed: Sequence[str]) -> Iterator[Table]:
    """Yield each sheet of a workbook that is such a table; if none is, the one most like it."""
    import openpyxl

    likeliest: list[str] = []
    is_table = False
    for sheet in openpyxl.load_workbook(file, read_only=True, data_only=True).worksheets:
        values = sheet.iter_rows(values_only=True)
        for number, row in enumerate(itertools.islice(values, HEADER_ROWS_MAX), 1):
            names = ["" if cell is None else str(cell) for cell in row]
            likeliest = max(
                likeliest or names, names, key=lambda names: count_needed(names, needed)
            )
            if count_needed(names, needed) == len(needed):
                is_table = True
                yield names, number, values
                break
    if not is_table:
        yield likeliest, 0, iter(())
