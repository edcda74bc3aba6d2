"""The queries on ``admin/{command}``, by which an operator's program reaches the daemon."""

from __future__ import annotations

import msgspec
from msgspec import Struct

from camtopod.admin import Command, Forget, Rename, Reset, TakeBack
from camtopod.serve.bus import QueryError

KEYS = ("forget", "rename", "reset")
"""Commands that may stand after ``admin/``."""


class Done(Struct):
    """The answer to an operator's command: it is stored and in force.

    done: the result, as a sentence.
    """

    done: str


def parameters_of(command: Command) -> tuple[str, dict[str, str]]:
    """Return the key below the site, and the parameters, of the query for a command."""
    match command:
        case Forget(camera):
            return "admin/forget", {"camera": camera}
        case TakeBack(camera):
            return "admin/forget", {"camera": camera, "take_back": "true"}
        case Rename(old, new):
            return "admin/rename", {"old": old, "new": new}
        case Reset():
            return "admin/reset", {}


def command_of(key: str, parameters: dict[str, str]) -> Command:
    """Return the command that a query asks for; raise `QueryError`."""
    given = parameters

    def read(kind: type[Command], **fields: str | None) -> Command:
        missing = [name for name, value in fields.items() if value is None]
        if missing:
            raise QueryError(f"{key} needs the parameter {missing[0].rstrip('_')}")
        try:
            return msgspec.convert(fields, kind, strict=True)
        except msgspec.ValidationError as error:
            raise QueryError(f"{key}: {error}") from None

    match key.removeprefix("admin/"):
        case "forget":
            take_back = given.get("take_back", "false") == "true"
            return read(TakeBack if take_back else Forget, camera=given.get("camera"))
        case "rename":
            return read(Rename, old=given.get("old"), new=given.get("new"))
        case "reset":
            return Reset()
        case _:
            raise QueryError(f"there is no command {key}; there are {', '.join(KEYS)}")
