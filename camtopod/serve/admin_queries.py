"""Queries on ``admin/{command}``, by which an operator's program reaches the daemon."""

from __future__ import annotations

import msgspec
from msgspec import Struct
from msgspec.structs import fields

from camtopod import codec
from camtopod.admin import Command, Forget, Rename, Reset, TakeBack
from camtopod.serve.bus import QueryError


class Done(Struct):
    """The answer to an operator's command: it is stored and in force.

    done: the result, as a sentence.
    """

    done: str


def parameters_of(command: Command) -> tuple[str, dict[str, str]]:
    """Return the key below the site, and the parameters, of the query for a command."""
    parameters = {
        field.name: getattr(command, field.name) for field in fields(command) if field.required
    }
    return f"admin/{command.__struct_config__.tag}", parameters


def command_of(key: str, parameters: dict[str, str]) -> Command:
    """Return the command that a query asks for; raise `QueryError`."""
    content = {**parameters, "type": key.removeprefix("admin/")}
    content.pop("format", None)  # of the answer
    try:
        command: Command = msgspec.convert(
            content, Forget | TakeBack | Rename | Reset, strict=False
        )
    except msgspec.ValidationError as error:
        raise QueryError(f"{key}: {codec.in_words(error)}") from None

    # Fields with defaults are the daemon's own.
    unknown = content.keys() - {"type", *(field.name for field in fields(command))}
    defaults = [field for field in fields(command) if not field.required]
    unknown |= {field.name for field in defaults if getattr(command, field.name) != field.default}
    if unknown:
        raise QueryError(f"{key}: unknown parameter {', '.join(sorted(unknown))}: nothing is done")
    return command
