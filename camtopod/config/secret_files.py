"""Read and write files that hold secrets, and find those that others can read."""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Iterable
from pathlib import Path

from camtopod import files

BYTES_MAX = 4096
"""Most bytes of a file that `read` looks at."""


def read(path: Path) -> str:
    """Return the first line of a file that holds one secret.

    Raises `OSError`, also if the line is empty or not UTF-8.
    """
    with path.open("rb") as file:
        line = file.read(BYTES_MAX).split(b"\n", 1)[0].strip()
    try:
        text = line.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise OSError(22, "is not UTF-8 text", str(path)) from None
    if not text:
        raise OSError(22, "has an empty first line", str(path))
    return text


def write(path: Path, content: bytes, mode: int = 0o600) -> None:
    """Write a file whole or not at all, readable by its owner alone from the first byte on.

    Raises `OSError`.

    mode: permissions of the file. With another mode than 0600 the file is shared: it gets the owner
        and the group of its folder, if this user may set them.
    """
    with files.writing(path, mode) as file:
        if mode != 0o600:
            with contextlib.suppress(PermissionError):
                folder_stat = path.parent.stat()
                os.fchown(file.fileno(), folder_stat.st_uid, folder_stat.st_gid)
        file.write(content)


def find_exposed(paths: Iterable[Path]) -> list[str]:
    """Return a sentence for each file that others can read or write, or whose group can write it.

    A group may read a file, as services share files so. Missing files are not exposed.
    """
    result = []
    for path in dict.fromkeys(paths):
        try:
            mode = path.stat().st_mode
        except OSError:
            continue
        if mode & (stat.S_IROTH | stat.S_IWOTH | stat.S_IWGRP):
            can = "read" if mode & stat.S_IROTH else "written"
            result.append(
                f"{path} holds a secret and can be {can} by others of this machine:"
                f" chmod 600 or 640"
            )
    return result
