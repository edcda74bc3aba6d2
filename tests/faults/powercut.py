"""Possible contents of the disk after a power cut, from a record of SQLite's operations.

Synced data is certain; of the rest any operations may be there, in any order, or all of them, as
when the process alone is killed. Directory entries (files made or deleted) are certain once the
directory is synced. Data of a failed sync is not written by a later one (Linux regards it as
written), so it counts as never written.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, NamedTuple

from vfs import Op

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


class Disk:
    """The state of the disk while operations go on."""

    def __init__(self) -> None:
        self._certain: dict[str, _File] = {}
        self._since: list[tuple[str, _File | None]] = []
        """Uncertain changes of the directory: files that were made, or (None) deleted."""
        self._files: dict[str, _File] = {}

    def apply(self, op: Op) -> None:
        if op.kind == "create":
            file = self._files[op.path] = _File(op.directory)
            self._since.append((op.path, file))
        elif op.kind == "delete":
            if self._files.pop(op.path, None) is not None:
                self._since.append((op.path, None))
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
        elif op.kind not in ("begun", "done"):
            self._files[op.path].since.append(op)

    def content(self, chance: random.Random | None = None) -> Content:
        """Return a possible content after a power cut; without ``chance`` what is certain."""
        share = 0.0 if chance is None else chance.choice((0.1, 0.5, 0.9, 1.0))
        chance = chance or random.Random(0)
        entries = dict(self._certain)
        for name, file in self._since:
            if chance.random() >= share:
                continue
            if file is None:
                entries.pop(name, None)
            else:
                entries[name] = file

        contents = {}
        for name, file in entries.items():
            content = bytearray(file.certain)
            kept = [op for op in file.since if chance.random() < share]
            if share < 1.0 and chance.random() < 0.5:
                chance.shuffle(kept)
            for op in kept:
                _do(content, op)
            contents[name] = bytes(content)
        return contents

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
    after_op: int


def images(ops: list[Op], each: int) -> Iterator[Image]:
    """Yield what is certain after every operation, and ``each`` other contents that are possible."""
    disk, chance = Disk(), random.Random(1)
    done = begun = -1
    last: Content = {}
    for number, op in enumerate(ops):
        disk.apply(op)
        if op.kind == "done":
            done = op.offset
        elif op.kind == "begun":
            begun = op.offset
        for draw in (None, *[chance] * each):
            content = disk.content(draw)
            if content != last or op.kind == "done":
                yield Image(content, done, begun, number)
            last = content


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
