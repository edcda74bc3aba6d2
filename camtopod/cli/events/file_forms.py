"""The form of a file: text in some encoding, or another form, and how to convert it."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from typing import Protocol

from camtopod.cli.exits import InputError

PIECE_BYTES = 1 << 16
"""Longest piece that is read at a time: whatever has come of it."""
_BINARY_BYTES = 1024
"""Bytes at the beginning that tell whether a file is text."""
_TABLE = "and save it as CSV with the columns camera, kind, t"
_OTHER_FORMS = {
    rb"\x1f\x8b": "compressed: pipe it through gunzip -c",
    rb"BZh": "compressed: pipe it through bunzip2 -c",
    rb"\xfd7zXZ": "compressed: pipe it through xz -dc",
    rb"\x28\xb5\x2f\xfd": "compressed: pipe it through zstd -dc",
    rb"\x04\x22\x4d\x18": "compressed: pipe it through lz4 -dc",
    rb"7z\xbc\xaf\x27\x1c|Rar!": "a compressed archive: unpack it",
    rb"PK\x03\x04.{26}mimetypeapplication/vnd\.oasis": "an OpenDocument file: save it as "
    ".xlsx or CSV",
    rb"PK\x03\x04": "a zip file: pipe it through unzip -p",
    rb"SQLite format 3\0": "a SQLite database: export the table with sqlite3 -header -csv FILE "
    "'SELECT camera, kind, t, x, y, track FROM ...' > events.csv",
    rb".{8}DUCK": 'a DuckDB database: export the table with duckdb FILE -c "COPY (SELECT camera, '
    "kind, t, x, y, track FROM ...) TO 'events.csv'\"",
    rb"\x89HDF": f"an HDF5 file: read it with pandas or h5py {_TABLE}",
    rb"CDF[\x01\x02\x05]": f"a NetCDF file: read it with xarray {_TABLE}",
    rb"\x93NUMPY": f"a NumPy array: read it with numpy.load {_TABLE}",
    rb"\x80[\x02-\x05][\x95c}\]]": "a Python pickle, which may run programs: read it where it was "
    f"written {_TABLE}",
    rb"ORC": f"an ORC file: read it with pyarrow.orc {_TABLE}",
    rb"Obj\x01": f"an Avro file: read it with fastavro {_TABLE}",
    rb"MATLAB 5": f"a MATLAB file: use writetable {_TABLE}",
    rb"RD[AX][234]\n": f"an R workspace: use write.csv {_TABLE}",
    rb"\xd0\xcf\x11\xe0": "an old Excel or Access file: save it as .xlsx or CSV",
    rb"%PDF": "a PDF, not the events",
    rb"\s*<(!doctype |!DOCTYPE )?(html|HTML)\b": "a web page (of a login?), not the events",
    rb"(?>--[^\n]*\n|/\*.*?\*/;?|\s)*(CREATE |DROP |INSERT INTO|COPY \S+ \(|SET \w+ ?=|PRAGMA )": (
        f"a dump of a database: load it, export the table {_TABLE}"
    ),
    rb'\s*\{\s*"type"\s*:\s*"FeatureCollection"': "GeoJSON: take the events out with jq -c "
    "'.features[].properties', if camera, kind and t are there",
    rb'\s*\{(\s*"(?!camera")\w+"\s*:\s*("[^"\n]*"|[\w.+-]+)\s*,)*'
    rb'\s*"(data|events|records|rows|results|items)"\s*:\s*\[': (
        "one JSON object around a list of events: take them out with jq -c '.[] | arrays | .[]'"
    ),
    rb'\s*\{\s*"(0|camera|kind|t|x|y|track|label|columns|index|schema)"\s*:\s*[\[{]': (
        "one JSON object of columns, as pandas' to_json() writes it: use "
        'to_json("events.jsonl", orient="records", lines=True)'
    ),
    rb"\s*\[\s*\[": "a JSON array of arrays: write an object with camera, kind, t for each event",
}
"""Beginnings of files that hold no lines of text, and how to convert each."""
_UNICODE = {
    rb"\xff\xfe\0\0|\0\0\xfe\xff": "utf-32",
    rb"\xff\xfe|\xfe\xff": "utf-16",
    rb"([^\0]\0){2}": "utf-16-le",
    rb"(\0[^\0]){2}": "utf-16-be",
}
"""Beginnings of texts that are not in UTF-8, and their encoding."""
_CONTROL = re.compile(rb"[\x01-\x08\x0e-\x19\x1c\x1d\x1f]")


class Readable(Protocol):
    """A file, or its first bytes."""

    def read1(self, size: int, /) -> bytes:
        """Read at most ``size`` bytes; block until there are some. Empty at the end of input."""


def pieces(path: str, file: Readable, beginning: bytes = b"") -> Iterator[bytes]:
    """Yield the content of a text as soon as it arrives; UTF-16 as UTF-8.

    beginning: bytes that were read before.

    Raises `InputError` for a file that is no text, and for JSON that has no events one by one.
    """
    piece = beginning or file.read1(PIECE_BYTES)
    for encoding in (name for magic, name in _UNICODE.items() if re.match(magic, piece)):
        decoder = codecs.getincrementaldecoder(encoding)("replace")
        while piece:
            yield decoder.decode(piece).encode("utf-8", "replace")
            piece = file.read1(PIECE_BYTES)
        return

    for magic, form in _OTHER_FORMS.items():
        if re.match(magic, piece, re.DOTALL):
            raise InputError(f"{path} is {form}")
    if _CONTROL.search(piece[:_BINARY_BYTES]):
        raise InputError(f"{path} is binary: export its events as lines of JSON or as a CSV table")
    while piece:
        yield piece
        piece = file.read1(PIECE_BYTES)
