"""Files that are not for everybody: reading one, writing one, and whether others can read them."""

from __future__ import annotations

import contextlib
import os
import re
import stat
from collections.abc import Iterable
from pathlib import Path

BYTES_MAX = 4096


def read(path: Path) -> str:
    """The first line of a file that holds one secret. Raises `OSError`, also if it is empty or not
    text.
    """
    try:
        with path.open("rb") as file:
            line = file.read(BYTES_MAX).split(b"\n", 1)[0].strip()
    except FileNotFoundError as error:
        unset = re.search(
            r"\$\{?\w+\}?", str(path)
        )  # as $CREDENTIALS_DIRECTORY outside of a service
        raise (
            error
            if unset is None
            else OSError(error.errno, f"{unset[0]} is not set here", str(path))
        ) from None
    try:
        text = line.decode("utf-8")
    except UnicodeDecodeError:
        raise OSError(22, "is not UTF-8 text", str(path)) from None
    if not text:
        raise OSError(22, "has an empty first line", str(path))
    return text


def write(path: Path, content: bytes, mode: int = 0o600) -> None:
    """Whole or not at all, for its owner alone (0600) from its first byte on. Raises `OSError`.

    With another ``mode`` it is shared, and belongs to whom its folder belongs, if this user may
    give it away.
    """
    new = path.with_name(f".{path.name}.new")
    new.unlink(missing_ok=True)
    fd = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    with os.fdopen(fd, "wb") as file:
        if mode != 0o600:
            with contextlib.suppress(PermissionError):
                its = path.parent.stat()
                os.fchown(fd, its.st_uid, its.st_gid)
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    os.replace(new, path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)  # or the old file could be back after a power cut
    finally:
        os.close(folder)


def exposed(paths: Iterable[Path]) -> list[str]:
    """A sentence for each file that everybody on this machine can read or write, or whose group can
    write it.

    That its group can read a file is how services share it; what is not there is not exposed.
    """
    found = []
    for path in dict.fromkeys(paths):
        try:
            mode = path.stat().st_mode
        except OSError:
            continue
        if mode & (stat.S_IROTH | stat.S_IWOTH | stat.S_IWGRP):
            can = "read" if mode & stat.S_IROTH else "written"
            found.append(
                f"{path} holds a secret and can be {can} by others of this machine: chmod 600 or 640"
            )
    return found
