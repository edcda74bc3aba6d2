"""Write files: whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO


@contextlib.contextmanager
def writing(path: str | Path, mode: int | None = None) -> Iterator[BinaryIO]:
    """Open a file that gets its name, and an older one's place, when all of it is on disk.

    If the block fails, an older file stays as it was. A pipe or a device is opened and written
    into, and so is a file whose folder takes no other one. Symbolic links are followed.

    mode: permissions; by default those of the older file, or the usual ones.

    Raises `OSError`; if the file cannot be opened, with ``path`` as it was given.
    """
    target = Path(path)
    try:
        fd, new = _opened(target, mode)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
    if new is None:
        with os.fdopen(fd, "wb") as file:
            yield file
        return

    # Write the new file; then put it in the old one's place.
    try:
        with os.fdopen(fd, "wb") as file:
            yield file
            file.flush()
            os.fsync(fd)
        _put(new, target.resolve())
    finally:
        new.unlink(missing_ok=True)


def _put(new: Path, old: Path) -> None:
    """Give a new file the name of an old one."""
    try:
        os.replace(new, old)
    except OSError as error:
        if error.errno != errno.EBUSY:
            raise
        shutil.copyfile(new, old)  # mounted alone, as containers do
        return
    with contextlib.suppress(OSError):  # not all file systems can
        folder = os.open(old.parent, os.O_RDONLY)
        try:
            os.fsync(folder)  # else a power cut could bring the old file back
        finally:
            os.close(folder)


def _opened(path: Path, mode: int | None) -> tuple[int, Path | None]:
    """Return a descriptor to write to, and the new file's path; None if it writes into ``path``."""
    before = path.stat() if path.exists() else None
    if before is not None and not stat.S_ISREG(before.st_mode):
        return os.open(path, os.O_WRONLY), None
    if not path.parent.is_dir():
        raise OSError(errno.ENOENT, f"there is no folder {path.parent}")
    real = path.resolve()
    new = real.with_name(f".{real.name}.new")
    try:
        new.unlink(missing_ok=True)
        fd = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666 if mode is None else mode)
    except PermissionError:
        if before is None:
            raise
        return os.open(path, os.O_WRONLY | os.O_TRUNC), None
    with contextlib.suppress(PermissionError):  # of others, or a file system without owners
        if mode is None and before is not None:
            mode = stat.S_IMODE(before.st_mode)
            os.fchown(fd, before.st_uid, before.st_gid)
        if mode is not None:
            os.fchmod(fd, mode)
    return fd, new
