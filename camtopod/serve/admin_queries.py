"""The queries on ``admin/{command}``, by which an operator's program reaches the daemon."""

from __future__ import annotations

from typing import Any

import msgspec
from msgspec import Struct

from camtopod.admin import Command, Forget, Rename, Reset, TakeBack
from camtopod.serve.bus import QueryError


class Done(Struct):
    """The answer to an operator's command: it is stored and in force.

    done: the result, as a sentence.
    """

    done: str


def parameters_of(command: Command) -> tuple[str, dict[str, str]]:
    """Return the key below the site, and the parameters, of the query for a command."""
    match command:
        case TakeBack(camera):
            return "admin/forget", {"camera": camera, "take_back": "true"}
        case Reset():
            return "admin/reset", {}
        case _:
            return f"admin/{command.__struct_config__.tag}", msgspec.to_builtins(
                msgspec.structs.asdict(command)
            )


def command_of(key: str, parameters: dict[str, str]) -> Command:
    """Return the command that a query asks for; raise `QueryError`."""
    kinds: dict[str, Any] = {"forget": Forget, "rename": Rename, "reset": Reset}
    name = key.removeprefix("admin/")
    if name not in kinds:
        raise QueryError(f"there is no command {key}; there are {', '.join(kinds)}")
    if name == "reset":
        return Reset()
    kind = TakeBack if parameters.get("take_back") == "true" else kinds[name]
    try:
        command: Command = msgspec.convert(parameters, kind)
    except msgspec.ValidationError as error:
        raise QueryError(f"{key}: {error}") from None
    return command
