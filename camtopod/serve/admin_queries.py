"""Queries on ``admin/{command}``, by which an operator's program reaches the daemon."""

from __future__ import annotations

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
    parameters: dict[str, str] = msgspec.to_builtins(command)
    return f"admin/{parameters.pop('type')}", parameters


def command_of(key: str, parameters: dict[str, str]) -> Command:
    """Return the command that a query asks for; raise `QueryError`."""
    asked = {**parameters, "type": key.removeprefix("admin/")}
    try:
        command: Command = msgspec.convert(
            asked,
            Forget | TakeBack | Rename | Reset,
            strict=False,
        )
    except msgspec.ValidationError as error:
        raise QueryError(f"{key}: {error}") from None
    return command
