"""Exit statuses of the contract, and the errors which end a command with a message for a person."""

from __future__ import annotations

DONE = 0
FAILED = 1
USAGE = 2
INPUT = 66
BUS = 69
STATE = 74
CONFIG = 78


class CommandError(Exception):
    """Ends the command with ``status``; ``str()`` says what went wrong and what to do about it."""

    def __init__(self, message: str, status: int = FAILED) -> None:
        super().__init__(message)
        self.status = status


class InputError(CommandError):
    """An input cannot be read (66)."""

    def __init__(self, message: str) -> None:
        super().__init__(message, INPUT)
