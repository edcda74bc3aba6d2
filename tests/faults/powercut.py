"""Possible contents of the disk after a power cut, from a record of SQLite's operations.

Synced data is certain. Of the rest there may be nothing (``synced``), some of the operations in
some order (``subset``), or some sectors of them, with garbage or nothing in the others (``torn``).
Directory entries (files made or deleted) are certain once the directory is synced. Data of a failed
sync is not written by a later one (Linux regards it as written), so it counts as never written.
"""

from __future__ import annotations

import hashlib
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, NamedTuple

from vfs import Op

Model = Literal["synced", "subset", "torn"]
MODELS: tuple[Model, ...] = ("synced", "subset", "torn")
"""Models of what survives."""
SECTORS = (512, 4096)
"""Sizes of a sector, bytes."""

Content = dict[str, bytes]
"""File name -> content."""


class Record:
    """A record of operations, with marks.

    ``begun`` n: step n was started; ``done`` n: it was reported durable.
    """

    def __init__(self) -> None:
        self.ops: list[Op] = []

    def __call__(self, op: Op) -> None:
        if op.kind != "shm":
            self.ops.append(op._replace(path=Path(op.path).name))

    def mark(self, kind: Literal["begun", "done"], step: int) -> None:
        self.ops.append(Op(kind, "", step))


class _File:
    """Certain content of a file and later operations; ``first_sync`` syncs the directory, too."""

    def __init__(self, first_sync: bool) -> None:
        self.certain = bytearray()
        self.since: list[Op] = []
        self.first_sync = first_sync


class _Entry(NamedTuple):
    """An uncertain change of the directory: ``file`` was made, or (None) deleted."""

    name: str
    file: _File | None


class Disk:
    """The state of the disk while operations go on."""

    def __init__(self) -> None:
        self._certain: dict[str, _File] = {}
        self._since: list[_Entry] = []
        self._files: dict[str, _File] = {}

    def apply(self, op: Op) -> None:
        if op.kind == "create":
            file = self._files[op.path] = _File(op.directory)
            self._since.append(_Entry(op.path, file))
        elif op.kind == "delete":
            if self._files.pop(op.path, None) is not None:
                self._since.append(_Entry(op.path, None))
            if op.directory:
                self._sync_directory()
        elif op.kind == "sync failed":
            self._files[op.path].since.clear()
        elif op.kind == "sync":
            file = self._files[op.path]
            for one in file.since:
                _do(file.certain, one)
            file.since.clear()
            if file.first_sync:
                self._sync_directory()
                file.first_sync = False
        else:
            self._files[op.path].since.append(op)

    def image(self, model: Model, chance: random.Random) -> Content:
        """Return one of the possible contents after a power cut."""
        survives = chance.choice((0.1, 0.5, 0.9))
        entries = dict(self._certain)
        for name, file in self._since:
            if model != "synced" and chance.random() < survives:
                if file is None:
                    entries.pop(name, None)
                else:
                    entries[name] = file
        return {
            name: self._content(file, model, survives, chance) for name, file in entries.items()
        }

    def _content(self, file: _File, model: Model, survives: float, chance: random.Random) -> bytes:
        if model == "synced" or not file.since:
            return bytes(file.certain)
        content = bytearray(file.certain)
        ops = file.since
        if model == "torn":
            sector = chance.choice(SECTORS)
            ops = [piece for op in ops for piece in _pieces(op, sector)]
        kept = [op for op in ops if chance.random() < survives]
        if chance.random() < 0.5:
            chance.shuffle(kept)
        for op in kept:
            _do(content, op)
        if (
            model == "torn" and chance.random() < 0.5
        ):  # the file has its new length, but not its content
            end = max((op.offset + len(op.data) for op in ops if op.kind == "write"), default=0)
            missing = max(0, end - len(content))
            content += chance.randbytes(missing) if chance.random() < 0.5 else bytes(missing)
        return bytes(content)

    def _sync_directory(self) -> None:
        self._certain = dict(self._files)
        self._since.clear()


class Image(NamedTuple):
    """Contents of a disk after a power cut.

    ``done``: last step reported durable; ``begun``: last step started.
    """

    content: Content
    done: int
    begun: int
    model: Model
    after_op: int


def images(
    ops: list[Op], each: int, seed: int, models: tuple[Model, ...] = MODELS
) -> Iterator[Image]:
    """Yield different images after every operation, ``each`` of each model.

    The first model has a single image.
    """
    disk = Disk()
    done = begun = -1
    seen: set[bytes] = set()
    for number, op in enumerate(ops):
        if op.kind == "done":
            done = op.offset
        elif op.kind == "begun":
            begun = op.offset
        else:
            disk.apply(op)
        for model in models:
            chance = random.Random(f"{seed} {number} {model}")
            for _ in range(1 if model == "synced" else each):
                content = disk.image(model, chance)
                mark = hashlib.blake2b(repr((done, begun)).encode(), digest_size=16)
                for name in sorted(content):
                    mark.update(name.encode() + content[name])
                if mark.digest() not in seen:
                    seen.add(mark.digest())
                    yield Image(content, done, begun, model, number)


def put(content: Content, directory: Path) -> None:
    """Write these files to ``directory`` and delete all others."""
    for path in directory.iterdir():
        path.unlink()
    for name, data in content.items():
        (directory / name).write_bytes(data)


def _do(content: bytearray, op: Op) -> None:
    if op.kind == "truncate":
        del content[op.offset :]
        return
    if len(content) < op.offset:
        content += bytes(op.offset - len(content))
    content[op.offset : op.offset + len(op.data)] = op.data


def _pieces(op: Op, sector: int) -> Iterator[Op]:
    """Split a write at the borders of sectors."""
    if op.kind != "write":
        yield op
        return
    start, end = op.offset, op.offset + len(op.data)
    while start < end:
        stop = min(end, (start // sector + 1) * sector)
        yield op._replace(offset=start, data=op.data[start - op.offset : stop - op.offset])
        start = stop
